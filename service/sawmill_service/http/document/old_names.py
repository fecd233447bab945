"""Headers of answers to requests that use a deprecated field or route: `Deprecation` (RFC 9745) and a link.

There is no `Sunset` (RFC 8594): an old name is removed when a later version is installed, and nobody knows that day.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from urllib.parse import quote

import structlog
from fastapi import Response
from pydantic import BaseModel

from sawmill_platform.contracts.base import OutOfUse, out_of_use
from sawmill_service.access import Caller
from sawmill_service.dependencies import TheCaller
from sawmill_service.http.document.described_answers import Responses

_TEXT = {"type": "string"}
_HEADERS = {
    "Deprecation": {
        "description": "The route, or a field of the request, is out of use since then: `@` and seconds since 1970.",
        "schema": _TEXT,
    },
    "Link": {"description": "Link with `rel=deprecation` to the description of the change.", "schema": _TEXT},
}
log = structlog.get_logger(__name__)


def announced(ask: type[BaseModel]) -> Responses:
    """Describe the headers in the OpenAPI document for an ask that has deprecated fields."""
    return {202: {"headers": _HEADERS}} if list(out_of_use(ask)) else {}


def announce(ask: BaseModel, caller: Caller, response: Response) -> None:
    """Set the headers of the answer to an accepted ask, and log the deprecated fields with the key."""
    used = {name: mark for name, mark in out_of_use(type(ask)) if name in ask.model_fields_set}
    if used:
        fields = f"components/schemas/{type(ask).__name__}/properties"
        _set_headers(response, {f"{fields}/{name}": mark for name, mark in used.items()})
        log.warning("out-of-use", fields={name: mark.gone_in for name, mark in used.items()}, key_id=caller.key_id)


@dataclass(frozen=True)
class OldRoute:
    """Dependency of a deprecated route, which marks the route's answers."""

    method: str
    path: str
    mark: OutOfUse

    def __call__(self, caller: TheCaller, response: Response) -> None:
        """Set the headers of the answer, and log the use of the route with the key."""
        pointer = self.path.replace("~", "~0").replace("/", "~1")
        _set_headers(response, {quote(f"paths/{pointer}/{self.method.lower()}", safe="/~"): self.mark})
        log.warning("out-of-use", routes={str(self): self.mark.gone_in}, key_id=caller.key_id)

    def __str__(self) -> str:
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
OLD: Responses = {200: {"headers": _HEADERS}}  # answer of a deprecated route


def _set_headers(response: Response, used: Mapping[str, OutOfUse]) -> None:
    """Set the headers from deprecation marks by their JSON pointer in the OpenAPI document."""
    since = min(mark.moment for mark in used.values())
    links = [f'</openapi.json#/{pointer}>; rel="deprecation"; type="application/json"' for pointer in used]
    response.headers["Deprecation"] = f"@{int(since.timestamp())}"
    response.headers["Link"] = ", ".join(links)
