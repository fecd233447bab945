"""/v1/fixed-pairs: the drawing of the pairs; `asked` has the other routes."""

from typing import Annotated

from fastapi import Query, Request, Response

from sawmill_contracts.fixed_pairs import DECLARATION
from sawmill_platform.contracts.base import Identifier
from sawmill_platform.contracts.keys import Scope
from sawmill_service.dependencies import TheStore
from sawmill_service.drawing import FIGURE_BYTES, drawn_ring
from sawmill_service.http.document.described_answers import drawn
from sawmill_service.http.document.openapi_document import trying
from sawmill_service.http.problems import Refused
from sawmill_service.http.responses.answers import Png
from sawmill_service.http.responses.drawn import picture
from sawmill_service.http.route_rules import Router
from sawmill_service.pages.frame.page_frame import formats_of
from sawmill_service.routes.calibrations import InLanguage

router = Router(prefix="/v1/fixed-pairs", tags=["fixed-pairs"], reading=Scope.READ)


@router.get(
    "/{fixed_pairs_id}/ring.png",
    response_class=Png,
    summary="Get the drawing of the pairs",
    openapi_extra=trying(**DECLARATION.to_get.example),
    responses=drawn("fixed-pairs-not-found", "fixed-pairs-without-result"),
)
def get_ring(
    fixed_pairs_id: Identifier, request: Request, store: TheStore, asked: Annotated[InLanguage, Query()]
) -> Response:
    """Draw sources, detectors and the board in each passage, with the bound of the rays of each pair."""
    calibrated = store.asked(DECLARATION).get(fixed_pairs_id)
    result = calibrated.result
    if result is None:
        raise Refused(
            409,
            "fixed-pairs-without-result",
            f"fixed-pairs {fixed_pairs_id!r} is {calibrated.state} and has no drawing",
        )
    made_of, reader = (result.model_dump_json(), asked.language), formats_of(asked.language).reader
    return picture(request, made_of, lambda: drawn_ring(result, reader), size_bytes=FIGURE_BYTES)
