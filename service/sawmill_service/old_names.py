"""Answers to requests that use what is out of use say so: `Deprecation` (RFC 9745), and where it is described.

There is no `Sunset` (RFC 8594): an old name goes when somebody installs a later version, and nobody knows that day.
"""

import structlog
from fastapi import Response
from pydantic import BaseModel

from sawmill_service.access import Caller
from sawmill_service.refusals import Responses
from sawmill_worker.contracts.kinds import asked_kinds
from sawmill_worker.contracts.old_names import out_of_use

_TEXT = {"type": "string"}
_HEADERS = {
    "Deprecation": {
        "description": "The request has a field that is out of use, since this moment: `@` and seconds since 1970.",
        "schema": _TEXT,
    },
    "Link": {"description": "With `rel=deprecation`: where such a field is described.", "schema": _TEXT},
}
log = structlog.get_logger(__name__)


def announced(ask: type[BaseModel]) -> Responses:
    """How the OpenAPI document describes it on what a request is accepted with."""
    return {202: {"headers": _HEADERS}} if list(out_of_use(ask)) else {}


def announce(ask: BaseModel, caller: Caller, response: Response) -> None:
    """Set the headers of an accepted request, and log who uses what is out of use."""
    used = {name: mark for name, mark in out_of_use(type(ask)) if name in ask.model_fields_set}
    if not used:
        return
    since = min(mark.moment for mark in used.values())
    fields = f"/openapi.json#/components/schemas/{type(ask).__name__}/properties"
    links = [f'<{fields}/{name}>; rel="deprecation"; type="application/json"' for name in used]
    response.headers["Deprecation"] = f"@{int(since.timestamp())}"
    response.headers["Link"] = ", ".join(links)
    log.warning("out-of-use", fields={name: mark.gone_in for name, mark in used.items()}, key_id=caller.key_id)


def markdown_table() -> str:
    """All of them, as docs/http.md has it."""
    rows = [
        f"| `{name}` of `{declared.ask.__name__}` | {mark.since} | {mark.gone_in} | {mark.instead} |"
        for declared in asked_kinds()
        for name, mark in out_of_use(declared.ask)
    ]
    return "\n".join(["| out of use | since | gone in | instead |", "|---|---|---|---|", *rows])


if __name__ == "__main__":
    print(markdown_table())  # noqa: T201 - for docs/http.md
