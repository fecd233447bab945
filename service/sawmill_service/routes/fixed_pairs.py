"""The drawings of fixed pairs and of a log's marks; `asked` has the other routes."""

from collections.abc import Callable
from typing import Annotated, Any

from fastapi import Query, Request, Response

from sawmill_contracts import fixed_pairs, pair_logs
from sawmill_contracts.kinds import AskedKind
from sawmill_platform.contracts.base import Identifier
from sawmill_platform.contracts.keys import Scope
from sawmill_service.dependencies import TheStore
from sawmill_service.drawing import FIGURE_BYTES, drawn_marks, drawn_ring
from sawmill_service.http.document.described_answers import drawn
from sawmill_service.http.document.openapi_document import trying
from sawmill_service.http.problems import Refused
from sawmill_service.http.responses.answers import Png
from sawmill_service.http.responses.drawn import picture
from sawmill_service.http.route_rules import Router
from sawmill_service.pages.frame.page_frame import formats_of
from sawmill_service.routes.calibrations import InLanguage
from sawmill_store.store import Store
from sawmill_vocabulary.messages import Reader

router = Router(prefix="/v1", tags=["fixed-pairs"], reading=Scope.READ)


@router.get(
    "/fixed-pairs/{fixed_pairs_id}/ring.png",
    response_class=Png,
    summary="Get the drawing of the pairs",
    openapi_extra=trying(**fixed_pairs.DECLARATION.to_get.example),
    responses=drawn("fixed-pairs-not-found", "fixed-pairs-without-result"),
)
def get_ring(
    fixed_pairs_id: Identifier, request: Request, store: TheStore, asked: Annotated[InLanguage, Query()]
) -> Response:
    """Draw sources, detectors and the board in each passage, with the bound of the rays of each pair."""
    return _picture(request, store, fixed_pairs.DECLARATION, fixed_pairs_id, asked.language, drawn_ring)


@router.get(
    "/pair-logs/{pair_log_id}/marks.png",
    tags=["pair-logs"],
    response_class=Png,
    summary="Get the drawing of a log's marks",
    openapi_extra=trying(**pair_logs.DECLARATION.to_get.example),
    responses=drawn("pair-log-not-found", "pair-log-without-result"),
)
def get_marks(
    pair_log_id: Identifier, request: Request, store: TheStore, asked: Annotated[InLanguage, Query()]
) -> Response:
    """Draw the marks across the feed and along it, numbered by height, with standard deviations."""
    return _picture(request, store, pair_logs.DECLARATION, pair_log_id, asked.language, drawn_marks)


def _picture(
    request: Request,
    store: Store,
    declared: AskedKind[Any, Any],
    identifier: str,
    language: str,
    draw: Callable[[Any, Reader], bytes],
) -> Response:
    """Draw the result of one of these kinds."""
    answer = store.asked(declared).get(identifier)
    if (result := answer.result) is None:
        noun = declared.noun
        raise Refused(409, f"{noun}-without-result", f"{noun} {identifier!r} is {answer.state} and has no drawing")
    made_of, reader = (result.model_dump_json(), language), formats_of(language).reader
    return picture(request, made_of, lambda: draw(result, reader), size_bytes=FIGURE_BYTES)
