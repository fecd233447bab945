"""/v1/plans, and asking for them at /v1/phantoms/{phantom_id}/plans."""

from typing import Annotated

from fastapi import APIRouter, Query, Response

from sawmill_service.answers import Paging, accept
from sawmill_service.dependencies import TheSettings, TheStore, TheWake
from sawmill_service.openapi_document import trying
from sawmill_worker.contracts.base import Identifier, Page
from sawmill_worker.contracts.plans import Plan, PlanAsk, PlanLinks

router = APIRouter(prefix="/v1", tags=["phantoms"])

EXAMPLE = {
    "scanner_id": "example",
    "views": 20,
    "noise": 0.02,
    "theta": {
        "initial_angle_rad": 0.0,
        "detector_to_cor_mm": 740.0,
        "source_shift_mm": 200.0,
        "detector_shift_mm": 30.0,
        "detector_tilt": 0.2,
    },
}


class PlanFilter(Paging):
    """Which plans to list."""

    phantom_id: Identifier | None = None


@router.post(
    "/phantoms/{phantom_id}/plans",
    status_code=202,
    summary="Plan a calibration with a phantom",
    openapi_extra=trying(phantom_id="l-shape", body=EXAMPLE),
)
def ask_plan(
    phantom_id: Identifier, ask: PlanAsk, store: TheStore, settings: TheSettings, wake: TheWake, response: Response
) -> Plan:
    """The precision that one scan of the phantom will give on a scanner, before the phantom is made.

    The geometry is a nominal theta, or that of the scanner's active calibration.
    """
    plan = store.plans.accept(phantom_id, ask)
    wake(plan.job_id)
    accept(response, f"/v1/plans/{plan.id}", settings.retry_after_s)
    return _linked(plan)


@router.get("/plans", summary="List plans, newest first")
def list_plans(query: Annotated[PlanFilter, Query()], store: TheStore) -> Page[Plan]:
    """All of them, or those with one phantom."""
    page = store.plans.page(phantom_id=query.phantom_id, after=query.after, limit=query.limit)
    return page.model_copy(update={"items": [_linked(item) for item in page.items]})


@router.get("/plans/{plan_id}", summary="Get a plan")
def get_plan(plan_id: Identifier, store: TheStore) -> Plan:
    """Its state, and standard deviations and the predicted ray error once they are there."""
    return _linked(store.plans.get(plan_id))


def _linked(plan: Plan) -> Plan:
    links = PlanLinks(
        self=f"/v1/plans/{plan.id}", job=f"/v1/jobs/{plan.job_id}", phantom=f"/v1/phantoms/{plan.phantom_id}"
    )
    return plan.model_copy(update={"links": links})
