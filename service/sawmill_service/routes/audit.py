"""/v1/audit."""

from typing import Annotated

from fastapi import Query, Request, Response
from fastapi.responses import StreamingResponse

from sawmill_platform.contracts.audit import AuditEntry
from sawmill_platform.contracts.base import Page
from sawmill_platform.contracts.keys import Scope
from sawmill_service.dependencies import TheStore
from sawmill_service.http.document.described_answers import SAVED, refuses
from sawmill_service.http.responses.answers import NumberedPaging, of_type
from sawmill_service.http.responses.conditional import check_conditions
from sawmill_service.http.route_rules import Router

JsonLines = of_type("application/jsonl", StreamingResponse)

router = Router(tags=["keys"], reading=Scope.ADMIN)


@router.get("/v1/audit", summary="List who did what, newest first", responses=refuses("invalid-cursor"))
def list_audit(paging: Annotated[NumberedPaging, Query()], store: TheStore) -> Page[AuditEntry]:
    """List activations, roll-backs, deletions, changes of scanners and schedules, cancelled jobs, keys and logins."""
    return store.audit.page(after=paging.after, limit=paging.limit)


@router.get(
    "/v1/audit.jsonl",
    summary="Get the whole audit as a file",
    response_class=JsonLines,
    responses=SAVED | refuses("precondition-failed"),
)
def get_audit_file(request: Request, store: TheStore) -> Response:
    """Send all entries, oldest first, as one JSON object a line."""
    # A weak tag: entries that are added while the file is sent are sent too.
    tag = 'W/"{}-{}"'.format(*store.audit.extent())
    if held := check_conditions(request.headers, tag):
        return held
    lines = (entry.model_dump_json() + "\n" for entry in store.audit.all())
    return JsonLines(lines, headers={"Content-Disposition": 'attachment; filename="audit.jsonl"', "ETag": tag})
