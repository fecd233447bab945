"""Tags of what a `PUT` replaces, and `If-Match`, so that two editors do not undo each other (RFC 9110, 13.1.1)."""

import hashlib
from collections.abc import Mapping
from typing import Annotated, TypeVar

from fastapi import Depends, Header, Response
from starlette.datastructures import Headers

from sawmill_contracts.retention import Retention
from sawmill_contracts.scanners import ScannerSpec, StoredScanner
from sawmill_contracts.schedules import Schedule, ScheduleSpec
from sawmill_platform.contracts.base import Contract
from sawmill_platform.contracts.webhooks import Webhook
from sawmill_platform.database.paging import Check
from sawmill_service.http.document.refusals import Responses, refuses
from sawmill_service.http.responses.conditional import check_conditions

Resource = TypeVar("Resource", bound=Contract)

# Fields that a `PUT` replaces; the others change without an editor.
_REPLACED: Mapping[type[Contract], frozenset[str]] = {
    StoredScanner: frozenset(ScannerSpec.model_fields),
    Schedule: frozenset(ScheduleSpec.model_fields),
    Webhook: frozenset({"url", "description", "events", "enabled"}),
    Retention: frozenset({"rules"}),
}

_TAG = {
    "description": "Tag of the fields that a `PUT` replaces: send it back as `If-Match`.",
    "schema": {"type": "string"},
    "required": True,
}
TAGGED: Responses = {200: {"headers": {"ETag": _TAG}}}
"""Answer with a resource that can be replaced."""
REPLACED: Responses = TAGGED | refuses("precondition-failed")
"""Answer of a route that replaces a resource."""


def precondition(
    if_match: Annotated[
        str | None,
        Header(
            max_length=1000,
            description="The `ETag` that was read: 412 if the resource was replaced since. Default: replace it anyway.",
        ),
    ] = None,
) -> Check[Contract]:
    """Return a function that refuses the request (412) if the stored resource is not the one that was read."""
    headers = Headers({} if if_match is None else {"If-Match": if_match})

    def check(resource: Contract) -> None:
        check_conditions(headers, edit_tag(resource))

    return check


ThePrecondition = Annotated[Check[Contract], Depends(precondition)]


def tagged(response: Response, resource: Resource) -> Resource:
    """Set the tag of an answer with a resource that can be replaced, and return the resource."""
    response.headers["ETag"] = edit_tag(resource)
    return resource


def edit_tag(resource: Contract) -> str:
    """Return the tag of the fields of a resource that an editor replaces."""
    replaced = resource.model_dump_json(include=set(_REPLACED[type(resource)]))
    return f'"{hashlib.sha256(replaced.encode()).hexdigest()[:32]}"'
