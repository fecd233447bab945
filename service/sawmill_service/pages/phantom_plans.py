"""What a plan promises, held against the scanner's tolerances: the two questions, before the phantom is made."""

from collections.abc import Iterator
from dataclasses import dataclass

from sawmill_service.pages.frame import PageFrame
from sawmill_service.pages.phantom_words import formats_of
from sawmill_worker.contracts.phantoms import PhantomDrawing
from sawmill_worker.contracts.plans import Plan
from sawmill_worker.contracts.scanners import StoredScanner
from sawmill_worker.contracts.two_questions import MillimetresRight, RaysRight
from sawmill_worker.storage.errors import NotFound
from sawmill_worker.storage.store import Store
from sawmill_worker.vocabulary import LARGEST_ASSUMED_LOG_RADIUS_MM

SHOWN = 3


@dataclass(frozen=True)
class PlanView:
    """One plan as its page shows it.

    Attributes
    ----------
    scanner : StoredScanner or None
        None: it was deleted since.
    rays, millimetres : str
        The sentences of the two questions; empty while there is no answer.
    """

    plan: Plan
    scanner: StoredScanner | None
    questions: tuple[RaysRight, MillimetresRight] | None = None
    rays: str = ""
    millimetres: str = ""


def plan_views(store: Store, phantom_id: str, drawing: PhantomDrawing, page: PageFrame) -> Iterator[PlanView]:
    """The newest plans with a phantom."""
    for plan in store.plans.page(phantom_id=phantom_id, limit=SHOWN).items:
        scanner = _scanner(store, plan.scanner_id)
        if plan.result is None or scanner is None:
            yield PlanView(plan, scanner)
            continue
        rays, millimetres = _questions(plan, scanner, drawing)
        formats, words = formats_of(page), page.text.gettext
        yield PlanView(
            plan,
            scanner,
            (rays, millimetres),
            rays.sentence(words, formats.mm),
            millimetres.sentence(words, formats.length, formats.share),
        )


def _scanner(store: Store, scanner_id: str) -> StoredScanner | None:
    try:
        return store.scanners.get(scanner_id)
    except NotFound:
        return None


def _questions(plan: Plan, scanner: StoredScanner, drawing: PhantomDrawing) -> tuple[RaysRight, MillimetresRight]:
    """By the tolerances as they stand now: nothing has been decided by a plan."""
    assert plan.result is not None  # noqa: S101 - the caller has looked
    upper_mm, tolerances = plan.result.predicted_ray_error_mm.upper_95, scanner.tolerances
    rays = RaysRight(
        upper_95_mm=upper_mm,
        limit_mm=tolerances.predicted_ray_error_mm,
        verdict="pass" if upper_mm <= tolerances.predicted_ray_error_mm else "fail",
    )
    reach_mm = scanner.log_radius_mm or min(LARGEST_ASSUMED_LOG_RADIUS_MM, 0.5 * max(drawing.extent_mm))
    return rays, MillimetresRight(plan.result.scale_uncertainty_percent, tolerances.scale_percent, 2.0 * reach_mm)
