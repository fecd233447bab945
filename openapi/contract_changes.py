"""Changes between two OpenAPI documents, and the version that the later one needs.

Words and examples do not count. Names do, where names in generated clients follow from them: of operations,
parameters and types. `python openapi/contract_changes.py` lists what changed since the last release.
"""

import json
import sys
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from contract_parts import Change, Kind, Place, without_words
from schema_alternatives import alternatives, as_json
from schema_changes import SchemaChanges

HERE = Path(__file__).parent
CONTRACT, RELEASED = HERE / "openapi.json", HERE / "released.json"
# A scope includes those before it.
SCOPES = ("read", "submit", "activate", "admin")
# How a parameter is written that does not state it (OpenAPI 3.1, Parameter Object).
STYLES = {"query": "form", "cookie": "form", "path": "simple", "header": "simple"}

Document = Mapping[str, Any]


def compare(old: Document, new: Document) -> list[Change]:
    """Find every change that is more than words; incompatible ones first, then by pointers."""
    found = _Comparison().of_documents(Place(old, old), Place(new, new))
    return sorted(found, key=lambda change: (-change.kind, change))


def needed_version(released: str, changes: Iterable[Change]) -> str:
    """Return the lowest version that a contract with these changes may have; a patch never changes the contract.

    Semantic Versioning 2.0.0, items 4, 7 and 8. Below 1.0.0 the minor version is raised for both kinds of change.
    """
    major, minor, _ = version_tuple(released)
    kinds = {change.kind for change in changes}
    if not kinds:
        return released
    return f"{major + 1}.0.0" if Kind.INCOMPATIBLE in kinds and major else f"{major}.{minor + 1}.0"


def version_tuple(version: str) -> tuple[int, int, int]:
    """Parse a version's three numbers, for comparison; ValueError for anything else."""
    major, minor, patch = (int(part) for part in version.split("."))
    return major, minor, patch


def fault_of_version(released: Document, today: Document) -> str | None:
    """Explain why today's document may not have its version, with the changes and the remedy; None if it may."""
    changes = compare(released, today)
    before, now = released["info"]["version"], today["info"]["version"]
    needed = needed_version(before, changes)
    if version_tuple(now) >= version_tuple(needed):
        return None
    listed = "\n".join(f"  {change}" for change in changes) or "  nothing"
    return (
        f"The version of the contract is {now}, and must be {needed} or later. Since the last release, {before} "
        f"(openapi/released.json), this changed:\n{listed}\n"
        "Either raise VERSION in worker/sawmill_vocabulary/version.py and the first heading of CHANGELOG.md, "
        "and run `make openapi clients`; or take the changes back, and keep old names beside the new ones "
        "(docs/look-up/http.md#versions)."
    )


class _Comparison(SchemaChanges):
    """Collects changes of routes; the comparison of schemas is inherited."""

    def of_documents(self, old: Place, new: Place) -> set[Change]:
        was, now = (place.at("components", "schemas") for place in (old, new))
        for name in was.value.keys() - now.value.keys():
            self.note(Kind.INCOMPATIBLE, was, f"the type {name} is gone, which generated clients name a class by", name)
        for path, (item, its) in self.members(old.at("paths"), new.at("paths"), "path").items():
            for method, both in self.members(item, its, f"method of {path}").items():
                self._operations(*both, method=method)
        return self.found

    def _operations(self, old: Place, new: Place, *, method: str) -> None:
        for names in ("operationId", "tags"):  # names of functions and modules of generated clients
            self.compare_value(old, new, names)
        self.compare_deprecation(old, new)
        ways_in = new.value.get("security") or [{}]
        if not all(any(_opens(way, each) for way in ways_in) for each in old.value.get("security") or [{}]):
            before, after = (json.dumps(each.value.get("security", [])) for each in (old, new))
            self.note(Kind.INCOMPATIBLE, new, f"who may do this: from {before} to {after}", "security")
        self._parameters(old, new)
        self._request_bodies(old, new)
        answers = self.members(old.at("responses"), new.at("responses"), f"status of {method}", added=_new_status)
        for was, now in answers.values():
            self._answers(was, now)

    def _parameters(self, old: Place, new: Place) -> None:
        was, now = _parameters(old), _parameters(new)
        for name, each in was.items():
            if name in now:
                self.compare_deprecation(each, now[name])
                self._need(each, now[name], f"the {name}")
                self._writing(each, now[name], f"the {name}")
                self.compare(each.at("schema"), now[name].at("schema"), asked=True)
            else:
                self.note(Kind.INCOMPATIBLE, each, f"the {name} is gone")
        for name in now.keys() - was.keys():
            self._new_part(now[name], f"the {name}")

    def _writing(self, old: Place, new: Place, what: str) -> None:
        (style, apart), (style_now, apart_now) = _writing(old), _writing(new)
        if style != style_now:
            self.note(Kind.INCOMPATIBLE, new, f"style of {what} from {style} to {style_now}")
        kinds = {each.value.get("type") for each in alternatives(old.at("schema"))}
        if apart != apart_now and kinds & {"array", "object", None}:  # without meaning for a single value
            self.note(Kind.INCOMPATIBLE, new, f"explode of {what} from {as_json(apart)} to {as_json(apart_now)}")

    def _request_bodies(self, old: Place, new: Place) -> None:
        was, now = old.at("requestBody"), new.at("requestBody")
        if was.value and not now.value:
            self.note(Kind.INCOMPATIBLE, was, "the body is gone")
        elif now.value and not was.value:
            self._new_part(now, "the body")
        elif was.value:
            self._need(was, now, "the body")
            kinds = self.members(was.at("content"), now.at("content"), "media type of the body")
            for one, other in kinds.values():
                self.compare(one.at("schema"), other.at("schema"), asked=True)

    def _new_part(self, place: Place, what: str) -> None:
        if place.value.get("required", False):
            self.note(Kind.INCOMPATIBLE, place, f"{what} is new, and required")
        else:
            self.note(Kind.ADDITION, place, f"{what} is new")

    def _need(self, old: Place, new: Place, what: str) -> None:
        was, now = (place.value.get("required", False) for place in (old, new))
        if now and not was:
            self.note(Kind.INCOMPATIBLE, new, f"{what} is required, and was not")
        if was and not now:
            self.note(Kind.ADDITION, new, f"{what} is no longer required")

    def _answers(self, old: Place, new: Place) -> None:
        codes = "x-problem-codes"
        for code in set(old.value.get(codes, [])) - set(new.value.get(codes, [])):
            self.note(Kind.INCOMPATIBLE, new, f"the code {code} is gone", codes)
        if codes in old.value:
            for code in set(new.value.get(codes, [])) - set(old.value[codes]):
                self.note(Kind.ADDITION, new, f"the code {code} is new", codes)
        for was, now in self.members(old.at("headers"), new.at("headers"), "header of the answer").values():
            if was.value.get("required", False) and not now.value.get("required", False):
                self.note(Kind.INCOMPATIBLE, now, "the header may be missing, and was always there")
            self.compare(was.at("schema"), now.at("schema"), asked=False)
        for was, now in self.members(old.at("content"), new.at("content"), "media type of the answer").values():
            self.compare(was.at("schema"), now.at("schema"), asked=False)
            events = self.members(was.at("x-event-data"), now.at("x-event-data"), "event")
            for one, other in events.values():
                self.compare(one, other, asked=False)


def _parameters(operation: Place) -> dict[str, Place]:
    return {f"{each.value['in']} parameter {each.value['name']}": each for each in operation.at("parameters").items()}


def _writing(parameter: Place) -> tuple[str, bool]:
    """Return a parameter's style, and whether each value of a list or an object is separate."""
    style = parameter.value.get("style", STYLES[parameter.value["in"]])
    return style, parameter.value.get("explode", style == "form")


def _new_status(status: str) -> Kind:
    """Classify a new status: a refusal is one more reason to fail; programs do not understand any other new answer."""
    return Kind.ADDITION if status.startswith(("4", "5")) else Kind.INCOMPATIBLE


def _opens(way: Mapping[str, list[str]], held: Mapping[str, list[str]]) -> bool:
    """Return whether a security requirement admits a client that meets another; an empty one admits everybody."""
    ranks = {scheme: max(map(SCOPES.index, scopes), default=-1) for scheme, scopes in held.items()}
    return all(max(map(SCOPES.index, scopes), default=-1) <= ranks.get(scheme, -2) for scheme, scopes in way.items())


def main() -> int:
    """Print what changed since the last release; with `--release`, record the contract as a release's."""
    released, today = json.loads(RELEASED.read_text()), json.loads(CONTRACT.read_text())
    print(*compare(released, today), sep="\n")
    fault = fault_of_version(released, today)
    if fault is None and sys.argv[1:] == ["--release"]:
        RELEASED.write_text(json.dumps(without_words(today), indent=1, sort_keys=True) + "\n")
    print(fault or f"{today['info']['version']} is a version for this.", file=sys.stderr)
    return 0 if fault is None else 1


if __name__ == "__main__":
    sys.exit(main())
