"""Every table that is keyed by the members of an enum, or by the words of a closed set, has a row for each of them."""

import ast
import importlib
import re
from collections.abc import Collection, Iterator
from enum import Enum, StrEnum
from functools import cache
from pathlib import Path
from typing import NamedTuple, get_args

import jinja2

from sawmill_contracts.scanners import AlarmLimits
from sawmill_platform.contracts import event_kinds
from sawmill_platform.contracts.event_kinds import JOB_ENDS, EventType
from sawmill_platform.contracts.jobs import JobKind, RegisteredWord
from sawmill_platform.contracts.kind_declarations import declaration_of
from sawmill_service.pages.scanners import scanner_form
from sawmill_service.pages.scanners.scanner_history import EVENT_WORDS
from sawmill_store.scanners.history import SUBJECTS
from sawmill_vocabulary import Adjustment

ROOT = Path(__file__).parents[1]
# Tables that lack members, each with what becomes of a member that it lacks.
PARTIAL = {
    "service/sawmill_service/pages/frame/verdicts.py: _MOVED_WORDS": "the other answers keep the question's word",
    "service/sawmill_service/drawing.py: _LOGS": "the other pictures of a calibration show no log",
    "service/sawmill_service/pages/job_words.py: _MADE": "a kind without a page of results links to its numbers",
    "service/sawmill_service/pages/job_words.py: FATES": "the other events are not of an attempt at a job",
    "service/sawmill_service/pages/system/system.py: ACTIONS": "the audit keeps decisions alone",
    "service/sawmill_service/pages/scanners/scanner_history.py: EVENT_WORDS": "the other events are in no history",
    "worker/sawmill_store/requests/references.py: _WITHOUT_RESULT": "the other states have a result or will have one",
    "worker/sawmill_store/requests/references.py: _LOOK_UP": "a request has several inspections",
    "worker/sawmill_store/subjects/outputs.py: _FILES": "jobs of the other kinds write no file",
    "worker/sawmill_store/mill_tables.py: OWN_TABLES": "the rows of other kinds are in the table `asked`",
    "worker/sawmill_tomography/effect_priors.py: PRIORS": "the others are no groups of columns",
    "worker/sawmill_tomography/calibration/joint_fit/scan_model.py: LARGEST": "the other terms may have any size",
    "worker/sawmill_tomography/calibration/joint_fit/scan_model.py: SKIN_DEPTHS_MM": "the other terms are no skins",
    "worker/sawmill_tomography/pairs/fine.py: OF_PAIR": "the other terms are of the wood, or are not fitted",
    "worker/sawmill_tomography/pairs/fine.py: OF_WOOD": "the other terms are not of the wood, or are not fitted",
    "worker/sawmill_tomography/reconstruction/choosing.py: EXPECTED_ERRORS": "`auto` takes measured methods only",
}
# Members that belong to no table of their enum but to those of other code.
LEFT_OUT = {"worker/sawmill_tomography/reconstruction/choosing.py: METHODS": {"ReconstructionMethod.AUTO"}}


class Table(NamedTuple):
    """A dictionary in the sources: `file: name`, and the members of its enum for which it has no row."""

    place: str
    lacks: frozenset[str]


@cache
def sources() -> list[tuple[Path, ast.Module]]:
    paths = sorted(path for folder in ("service", "worker") for path in (ROOT / folder).rglob("*.py"))
    return [(path, ast.parse(path.read_text())) for path in paths if "migrations" not in path.parts]


def attribute(path: Path, name: str) -> object:
    parts = path.relative_to(ROOT).with_suffix("").parts[1:]
    return getattr(importlib.import_module(".".join(parts).removesuffix(".__init__")), name, None)


def closed_sets() -> Iterator[frozenset[str]]:
    """The words of each enum of words and of each named Literal."""
    for path, tree in sources():
        for node in tree.body:
            if isinstance(node, ast.ClassDef) and [ast.unparse(base) for base in node.bases] == ["StrEnum"]:
                enum = attribute(path, node.name)
                assert isinstance(enum, type)
                assert issubclass(enum, StrEnum)
                yield frozenset(member.value for member in enum)
            if isinstance(node, ast.Assign) and ast.unparse(node.value).startswith("Literal["):
                yield frozenset(map(str, get_args(attribute(path, ast.unparse(node.targets[0])))))


def dictionaries(node: ast.AST, name: str) -> Iterator[tuple[str, ast.Dict]]:
    """Each one below a node, by the name that it is assigned to, or by that of its function."""
    if isinstance(node, ast.Dict):
        yield name, node
    if isinstance(node, ast.Assign | ast.AnnAssign):
        name = ast.unparse(node.targets[0] if isinstance(node, ast.Assign) else node.target)
    if isinstance(node, ast.FunctionDef | ast.ClassDef):
        name = node.name
    for child in ast.iter_child_nodes(node):
        yield from dictionaries(child, name)


def member(path: Path, key: ast.expr | None) -> object:
    """What a key means, where it is a text or an enum's member."""
    if isinstance(key, ast.Constant):
        return key.value
    if isinstance(key, ast.Attribute) and isinstance(key.value, ast.Name) and key.attr.isupper():
        return getattr(attribute(path, key.value.id), key.attr, None)
    return None


def name_of(each: Enum | RegisteredWord) -> str:
    name = each.name if isinstance(each, Enum) else f"{each}"
    return f"{type(each).__name__}.{name}"


def members(enum: type[Enum] | type[RegisteredWord]) -> Iterator[object]:
    return iter(enum.all()) if issubclass(enum, RegisteredWord) else iter(enum)


def lacking(keys: Collection[object], word_sets: Collection[frozenset[str]]) -> frozenset[str] | None:
    """The members without a row; None where the keys are of no enum. Texts count where they are half of a set."""
    enums = {type(key) for key in keys if isinstance(key, Enum | RegisteredWord)}
    if enums and all(isinstance(key, Enum | RegisteredWord) for key in keys):
        return frozenset(name_of(each) for enum in enums for each in set(members(enum)) - set(keys))
    words = {key for key in keys if isinstance(key, str)}
    if enums or len(words) != len(keys) or len(words) < 2:
        return None
    near = [each for each in word_sets if words <= each and 2 * len(words) >= len(each)]
    return min((each - words for each in near), key=len, default=None)


def tables() -> Iterator[Table]:
    word_sets = set(closed_sets())
    for path, tree in sources():
        for name, found in dictionaries(tree, ""):
            keys = [member(path, key) for key in found.keys]
            if keys and (lacks := lacking(keys, word_sets)) is not None:
                place = f"{path.relative_to(ROOT)}: {name}"
                yield Table(place, lacks - LEFT_OUT.get(place, set()))
    environment = jinja2.Environment(extensions=["jinja2.ext.i18n"], autoescape=True)
    templates = [path for folder in ("service", "worker") for path in (ROOT / folder).rglob("templates/**/*.*")]
    for path in sorted(templates):
        for found in environment.parse(path.read_text()).find_all(jinja2.nodes.Dict):
            keys = [pair.key.value for pair in found.items if isinstance(pair.key, jinja2.nodes.Const)]
            if keys and (lacks := lacking(keys, word_sets)) is not None:
                yield Table(f"{path.relative_to(ROOT)}: line {found.lineno}", lacks)


def test_every_table_has_a_row_for_each_member():
    found = list(tables())
    assert len(found) > 30  # else the search finds nothing
    faults = [f"{place} lacks {', '.join(sorted(lacks))}" for place, lacks in found if lacks and place not in PARTIAL]
    assert not faults, "\n".join(("add the missing rows:", *faults))
    assert PARTIAL.keys() <= {place for place, lacks in found if lacks}, "these are complete, or gone"


def test_every_event_of_a_scanner_s_history_has_its_word():
    jobs = [declaration_of(kind).noun for kind in JobKind.all() if declaration_of(kind).topic]
    shown = {(event, noun) for event in JOB_ENDS for noun in jobs}
    shown |= {(event, event.split("-")[0]) for event in EventType.all() if event.topic}
    without = {event for event, _ in shown} - EVENT_WORDS.keys() - {event_kinds.SUCCEEDED}  # which shows a verdict
    assert not without, "add them to EVENT_WORDS in service/sawmill_service/pages/scanners/scanner_history.py"
    unknown = {noun for event, noun in shown if not event.startswith(("alarm-", "red-"))} - SUBJECTS.keys()
    assert not unknown, "add them to SUBJECTS in worker/sawmill_store/scanners/history.py"


def test_the_table_of_faults_names_adjustments():
    page = (ROOT / "docs/understand/verdict.md").read_text().split("## Scans with faults")[1].split("\n\n###")[0]
    rows = re.findall(r"^\| (`.*?) \|", page, re.MULTILINE)
    named = [name for row in rows for name in re.findall(r"`([\w-]+)`", row)]
    assert set(named) <= set(Adjustment), "mend the table of docs/understand/verdict.md#scans-with-faults"
    assert len(named) == len(set(named)) > 10


def test_every_limit_of_an_alarm_is_in_the_scanner_s_form():
    in_form = {field.place[1] for field in scanner_form.FIELDS if field.place[0] == "alarms"}
    assert in_form == AlarmLimits.model_fields.keys(), "add a field to scanner_form.py of sawmill_service/pages"
