"""Answers to requests that use what is out of use say so: `Deprecation` (RFC 9745), and where it is described.

There is no `Sunset` (RFC 8594): an old name goes when somebody installs a later version, and nobody knows that day.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from urllib.parse import quote

import structlog
from fastapi import Response
from pydantic import BaseModel

from sawmill_contracts.kinds import asked_kinds
from sawmill_contracts.old_names import OutOfUse, out_of_use
from sawmill_service.access import Caller
from sawmill_service.dependencies import TheCaller
from sawmill_service.http.document.refusals import Responses

_TEXT = {"type": "string"}
_HEADERS = {
    "Deprecation": {
        "description": "The route, or a field of the request, is out of use since this moment: `@` and seconds "
        "since 1970.",
        "schema": _TEXT,
    },
    "Link": {"description": "With `rel=deprecation`: where that is described.", "schema": _TEXT},
}
log = structlog.get_logger(__name__)


def announced(ask: type[BaseModel]) -> Responses:
    """How the OpenAPI document describes it on what a request is accepted with."""
    return {202: {"headers": _HEADERS}} if list(out_of_use(ask)) else {}


def announce(ask: BaseModel, caller: Caller, response: Response) -> None:
    """Set the headers of an accepted request, and log who uses what is out of use."""
    used = {name: mark for name, mark in out_of_use(type(ask)) if name in ask.model_fields_set}
    if used:
        fields = f"components/schemas/{type(ask).__name__}/properties"
        _set_headers(response, {f"{fields}/{name}": mark for name, mark in used.items()})
        log.warning("out-of-use", fields={name: mark.gone_in for name, mark in used.items()}, key_id=caller.key_id)


@dataclass(frozen=True)
class OldRoute:
    """A route that is out of use: a dependency of it, so that its answers say so."""

    method: str
    path: str
    mark: OutOfUse

    def __call__(self, caller: TheCaller, response: Response) -> None:
        """Set the headers of its answer, and log who asks for it."""
        pointer = self.path.replace("~", "~0").replace("/", "~1")
        _set_headers(response, {quote(f"paths/{pointer}/{self.method.lower()}", safe="/~"): self.mark})
        log.warning("out-of-use", routes={str(self): self.mark.gone_in}, key_id=caller.key_id)

    def __str__(self) -> str:
        """As requests have it."""
        return f"{self.method} {self.path}"


ACTIVATIONS = OldRoute(
    "GET",
    "/v1/scanners/{scanner_id}/history",
    OutOfUse(
        "0.2.0",
        "2026-11-23",
        gone_in="0.3.0",
        instead="`GET /v1/scanners/{scanner_id}/history/entries?kind=activation`",
    ),
)
OLD_ROUTES = (ACTIVATIONS,)
OLD: Responses = {200: {"headers": _HEADERS}}
"""What a route that is out of use answers with."""


def _set_headers(response: Response, used: Mapping[str, OutOfUse]) -> None:
    """By where in the OpenAPI document each is described."""
    since = min(mark.moment for mark in used.values())
    links = [f'</openapi.json#/{pointer}>; rel="deprecation"; type="application/json"' for pointer in used]
    response.headers["Deprecation"] = f"@{int(since.timestamp())}"
    response.headers["Link"] = ", ".join(links)


def markdown_table() -> str:
    """All of them, as docs/http.md has it."""
    marks = [
        (f"`{name}` of `{declared.ask.__name__}`", mark)
        for declared in asked_kinds()
        for name, mark in out_of_use(declared.ask)
    ]
    marks += [(f"`{route}`", route.mark) for route in OLD_ROUTES]
    rows = [f"| {name} | {mark.since} | {mark.gone_in} | {mark.instead} |" for name, mark in marks]
    return "\n".join(["| out of use | since | gone in | instead |", "|---|---|---|---|", *rows])


if __name__ == "__main__":
    print(markdown_table())  # noqa: T201 - for docs/http.md
