"""The pages that are made of the code and of the first notebook, and the list of all pages (`make docs`).

A page is a function that returns its Markdown, and a row of `PAGES`.
"""

import ast
import asyncio
import inspect
import json
import re
import sys
import tempfile
import textwrap
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import fields
from http import HTTPStatus
from pathlib import Path

import httpx
import typer
from generate_notebook import notebook_page, pictures
from generate_options import OPTION_TYPES, option_types
from generate_python import python_page
from prometheus_client.core import Metric
from pydantic_settings import BaseSettings
from starlette.types import ASGIApp

from sawmill_command.commands import main as program
from sawmill_contracts.declared_kinds import asked_kinds
from sawmill_platform.contracts.base import out_of_use
from sawmill_platform.contracts.jobs import FailureKind
from sawmill_platform.contracts.keys import Scope
from sawmill_platform.settings import StorageSettings
from sawmill_platform.workers.settings import ExecutionSettings
from sawmill_service.app import create_app
from sawmill_service.http.document.old_names import OLD_ROUTES
from sawmill_service.http.problem_types import ProblemType, problem_types
from sawmill_service.routes.scanners import COLUMNS
from sawmill_service.serving import no_wake
from sawmill_service.settings import ServiceSettings
from sawmill_store.store import Store
from sawmill_vocabulary.calibration_messages import CalibrationMessage, ResidualMessage
from sawmill_vocabulary.image_messages import ImageMessage
from sawmill_vocabulary.messages import Message
from sawmill_vocabulary.movement_messages import LogMessage, MovementMessage
from sawmill_vocabulary.pair_messages import PairMessage
from sawmill_vocabulary.physics import Physics
from sawmill_vocabulary.reading_messages import PreparingMessage, ReadingMessage
from sawmill_vocabulary.scan_messages import AdjustmentMessage, EffectMessage

DOCUMENTS = Path(__file__).resolve().parent
SHELVES = {
    "start": "Start: see it work, and make your first calibration.",
    "do": "Do: one task a page.",
    "look-up": "Look up: every route, code, setting, command and word.",
    "understand": "Understand: how it works, and how far its results can be trusted.",
    "understand/decisions": "Decisions: why the large choices were made.",
    "evidence": "Evidence: what was measured, written by the programs that measured it.",
}
SETTINGS: tuple[type[BaseSettings], ...] = (ServiceSettings, StorageSettings, ExecutionSettings)


def main() -> int:
    """Write the types of options, the pictures of the first notebook and every page, the list of the pages last."""
    OPTION_TYPES.write_text(option_types())
    for name, png in pictures().items():
        (DOCUMENTS / name).write_bytes(png)
    for name, page in PAGES.items():
        (DOCUMENTS / name).write_text(page())
    return 0


def table(head: Sequence[str], rows: Iterable[Iterable[str]]) -> str:
    """Return a table; a cell may have any text."""
    first, *others = (f"| {' | '.join(map(cell, row))} |\n" for row in (head, *rows))
    return "".join([first, f"{'|---' * len(head)}|\n", *others])


def cell(text: str) -> str:
    """Return a text in one line, its bars and, outside of code, its angle brackets as characters."""
    parts = " ".join(text.split()).replace("|", "\\|").split("`")
    parts[::2] = [part.replace("<", "&lt;") for part in parts[::2]]
    return "`".join(parts)


def code(text: str) -> str:
    """Return a text as code."""
    return f"`{text}`"


def routes() -> str:
    """Return the page of the routes: those of the contract by tag, scopes, old names and the columns of the history."""
    document = json.loads((DOCUMENTS.parent / "openapi/openapi.json").read_text())
    operations = [
        (method.upper(), path, operation)
        for path, item in document["paths"].items()
        for method, operation in item.items()
    ]
    page = "# Routes\n\nEvery route of the contract, with the scope that its key needs, and what is out of use.\n\n"
    page += "[http.md](http.md) explains requests and answers; `/docs` of a service shows every field.\n"
    for tag in document["tags"]:
        rows = [
            (method, code(path), needed(operation), operation["summary"])
            for method, path, operation in operations
            if operation["tags"] == [tag["name"]]
        ]
        page += f"\n## {tag['name'].capitalize()}\n\n{tag['description']}\n\n"
        page += table(("method", "path", "scope", "what"), rows)
    page += "\n## Scopes\n\nEach scope includes the scopes before it. A group is a scanner.\n\n"
    page += table(("scope", "a key of this scope may"), ((code(scope), text) for scope, text in scopes()))
    page += "\n## Out of use\n\nThese work until the version that is named.\n\n"
    page += table(("out of use", "since", "gone in", "instead"), old_names())
    page += "\n## Columns of history.csv\n\nA later version adds its own at the end.\n\n"
    return page + table(("number", "column"), ((str(number), code(name)) for number, name in enumerate(COLUMNS, 1)))


def needed(operation: dict[str, list[dict[str, list[str]]]]) -> str:
    """Return the scope that an operation needs."""
    return next((code(scope) for each in operation["security"] for [scope] in each.values()), "no key")


def scopes() -> Iterator[tuple[str, str]]:
    """Yield each scope with the text below it in the source."""
    [enum] = ast.parse(inspect.getsource(Scope)).body
    texts = [ast.literal_eval(node.value) for node in ast.iter_child_nodes(enum) if isinstance(node, ast.Expr)]
    yield from zip(Scope, texts[1:], strict=True)


def old_names() -> Iterator[tuple[str, str, str, str]]:
    """Yield a row for each field and route that is out of use."""
    marks = [
        (f"`{name}` of `{declared.ask.__name__}`", mark)
        for declared in asked_kinds()
        for name, mark in out_of_use(declared.ask)
    ]
    marks += [(code(str(route)), route.mark) for route in OLD_ROUTES]
    yield from ((name, mark.since, mark.gone_in, mark.instead) for name, mark in marks)


def codes() -> str:
    """Return the page of the codes: those of answers by status, those of failed jobs by cause."""
    kinds = problem_types().values()
    page = "# Codes\n\nEvery code of a refused request and of a failed job, with what to do.\n\n"
    page += "A service shows each at `/problems/CODE`, in Finnish too where jobs fail with it.\n"
    for status in sorted({kind.status for kind in kinds if kind.status is not None}):
        page += f"\n## {status} {HTTPStatus(status).phrase}\n\n"
        page += table(("code", "meaning", "what to do"), code_rows(kind for kind in kinds if kind.status == status))
    for cause in FailureKind:
        rows = [*code_rows(kind for kind in kinds if kind.failure is cause)]
        page += f"\n## Failed jobs: {cause}\n\n" + table(("code", "meaning", "what to do"), rows)
    return page


def code_rows(kinds: Iterable[ProblemType]) -> Iterator[tuple[str, str, str]]:
    """Yield a row for each kind of problem."""
    yield from ((code(kind.code), f"**{kind.title}**: {kind.when}", kind.what_to_do) for kind in kinds)


MESSAGES: Mapping[str, Sequence[type[Message]]] = {
    "Verdict": (CalibrationMessage, ResidualMessage),
    "Verdict on fixed pairs": (PairMessage,),
    "Adjustments: effects that are fitted": (EffectMessage,),
    "Adjustments: samples, cells, views": (AdjustmentMessage,),
    "Movements": (MovementMessage, LogMessage),
    "Remarks on a file": (ReadingMessage, PreparingMessage),
    "Remarks on an image": (ImageMessage,),
}


def reasons() -> str:
    """Return the page of the messages with codes: what results and scans say, and what to do."""
    page = "# Reasons and remarks\n\nEvery code of `coded_reasons`, `coded_adjustments`, `coded_reason` and remarks, "
    page += "with its sentences.\n\nNames in capitals stand for the values that come with the code.\n"
    for heading, kinds in MESSAGES.items():
        members = [member for kind in kinds for member in kind if member.headline or member.action]
        rows = ((code(member), *map(without_values, (member.headline, member.action))) for member in members)
        page += f"\n## {heading}\n\n" + table(("code", "what is said", "what to do"), rows)
    return page


def without_values(template: str) -> str:
    """Return the template of a sentence with the names of its values in their places, without units."""
    names = r"%\((\w+?)(?:_mm|_deg|_rad|_percent)?\)\+?(?:\.\d)?[sdfg]"
    named = re.sub(names, lambda place: place[1].replace("_", " ").upper(), template)
    return named.replace("%%", "%")


def settings() -> str:
    """Return the page of the settings, by the sections of their classes."""
    page = "# Settings\n\nEvery setting, by what one wants. A setting is an environment variable.\n"
    for section in (section for each in SETTINGS for section in each.__bases__):
        rows = (
            (code(f"SAWMILL_{name.upper()}"), shown(field.get_default(call_default_factory=True)), field.description)
            for name, field in section.model_fields.items()
        )
        page += f"\n## {inspect.getdoc(section).rstrip('.')}\n\n{table(('variable', 'default', 'what'), rows)}"
    return page


def shown(default: object) -> str:
    """Return a default as one would set it."""
    if default is None:
        return "null"
    if isinstance(default, Path):
        return code(f"~/{default.relative_to(Path.home())}")
    return code(f"{default:g}" if isinstance(default, float) else json.dumps(default).strip('"'))


def metrics() -> str:
    """Return the page of the metrics of a service that has answered one request."""
    with tempfile.TemporaryDirectory() as folder:
        store = Store.open(StorageSettings(data_folder=Path(folder), database_url=None))
        app = create_app(ServiceSettings(), store, no_wake)
        asyncio.run(one_request(app))
        families: list[Metric] = sorted(app.state.metrics.collect(), key=lambda family: family.name)
        store.close()
    page = "# Metrics\n\nEvery metric of `/metrics`, with its labels.\n\n"
    rows = (
        (code(each.name + "_total" * (each.type == "counter")), each.type, labels_of(each), each.documentation)
        for each in families
    )
    return page + table(("metric", "kind", "labels", "what"), rows)


async def one_request(app: ASGIApp) -> None:
    """Let a service answer a request, so that it counts one."""
    async with httpx.AsyncClient(transport=httpx.ASGITransport(app), base_url="http://127.0.0.1") as client:
        await client.get("/health/live")


def labels_of(family: Metric) -> str:
    """Return the labels of a metric; one without values has them as the names that it was made with."""
    with_values = {name: None for sample in family.samples for name in sample.labels if name != "le"}
    return ", ".join(map(code, getattr(family, "_labelnames", with_values)))


def commands() -> str:
    """Return the page of the commands of `sawmill`."""
    page = "# Commands\n\nEvery command of `sawmill`, with its options.\n\n"
    page += "`sawmill COMMAND --help` shows the same. A wrong option is refused with the nearest one that exists.\n"
    for name, command in commands_of("sawmill", typer.main.get_command(program)):
        with command.make_context(name, [], resilient_parsing=True) as context:
            records = [parameter.get_help_record(context) for parameter in command.get_params(context)]
        rows = [option_row(*record) for record in records if record and record[0] != "--help"]
        text = "\n\n".join(textwrap.fill(part, 120) for part in (command.help or "").split("\n\n"))
        page += f"\n## {name}\n\n{text}\n"
        page += f"\n{table(('option', 'what'), rows)}" if rows else ""
    return page


def option_row(option: str, text: str) -> tuple[str, str]:
    """Return the row of an option; what a list may hold is text, which a narrow column can break."""
    listed = re.search(r"<list\[(.*)\]>", option)
    if listed is None:
        return code(option), text
    return code(option.replace(listed[0], "<list>")), f"{text} Any of {', '.join(map(code, listed[1].split('|')))}."


def commands_of(name: str, command: "typer.main.Command") -> "Iterator[tuple[str, typer.main.Command]]":
    """Yield every command below one, with the words by which it is called."""
    below = getattr(command, "commands", None)
    if below is None:
        yield name, command
    for word, each in sorted((below or {}).items()):
        yield from commands_of(f"{name} {word}", each)


def physics() -> str:
    """Return the page of the effects that a simulation adds to an ideal scan."""
    page = "# Physics of a simulated scan\n\nEvery field of a file for `sawmill simulate --physics`. "
    page += "[simulate.md](../do/simulate.md) explains them.\n"
    for group in fields(Physics):
        rows = []
        for field in fields(group.default):
            bounds = field.metadata
            least = bounds["ge"] if "ge" in bounds else bounds.get("gt")
            limits = f"{'above ' * ('gt' in bounds)}{least:g} to {bounds['le']:g}" if "le" in bounds else "12, 16"
            default = "null" if field.default is None else f"{field.default:g}"
            rows.append((code(f"{group.name}.{field.name}"), default, limits, bounds["description"]))
        page += f"\n## {group.name.capitalize()}\n\n{group.metadata['description']}\n\n"
        page += table(("field", "default", "range", "what"), rows)
    return page


def index() -> str:
    """Return the list of all pages by shelf, each with its title and its first sentence."""
    page = "# Documents\n\nAll pages, by what a reader wants. A running service shows them at `/help`, with a search.\n"
    page += "The [README](../README.md) has the two commands to begin with.\n"
    for shelf, about in SHELVES.items():
        title, _, sentence = about.partition(": ")
        rows = [
            (f"[{name}]({path.relative_to(DOCUMENTS)})", first)
            for path in sorted((DOCUMENTS / shelf).glob("*.md"))
            for name, first in [title_and_sentence(path.read_text())]
        ]
        page += f"\n## {title}\n\n{sentence.capitalize()}\n\n{table(('page', 'what'), rows)}"
    return page


def title_and_sentence(text: str) -> tuple[str, str]:
    """Return a page's title and the first sentence below, without marks and links."""
    title, _, below = text.removeprefix("# ").partition("\n")
    plain = re.sub(r"<!--.*?-->|\[([^]]*)\]\([^)]*\)", r"\1", below, flags=re.DOTALL)
    paragraphs = (" ".join(part.split()) for part in plain.split("\n\n"))
    prose = next(part for part in paragraphs if re.match(r"[^\W\d]|[`*]", part))
    return title, re.split(r"(?<=[.!?]) ", prose)[0]


PAGES: dict[str, Callable[[], str]] = {
    "look-up/routes.md": routes,
    "look-up/codes.md": codes,
    "look-up/reasons.md": reasons,
    "look-up/settings.md": settings,
    "look-up/metrics.md": metrics,
    "look-up/commands.md": commands,
    "look-up/physics.md": physics,
    "look-up/python.md": python_page,
    "start/first-notebook.md": notebook_page,
    # The last one: it reads the others.
    "README.md": index,
}

if __name__ == "__main__":
    sys.exit(main())
