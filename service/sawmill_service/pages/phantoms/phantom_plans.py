"""Plans against the scanner's tolerances: the two questions, answered before the phantom is made."""

from collections.abc import Iterator
from dataclasses import dataclass

from sawmill_contracts.plans import Plan
from sawmill_contracts.scanners import StoredScanner
from sawmill_mill.two_questions import TwoQuestions
from sawmill_platform.errors import NotFound
from sawmill_service.pages.frame.page_frame import PageFrame
from sawmill_service.pages.frame.verdicts import ShownQuestion, shown_pair
from sawmill_store.scanners import Scanners
from sawmill_store.store import Plans

SHOWN = 3


@dataclass(frozen=True)
class PlanView:
    """A plan as its page shows it.

    Attributes
    ----------
    scanner : StoredScanner or None
        None: the scanner was deleted since.
    questions : list of ShownQuestion
        Empty while there is no answer, or no scanner with tolerances for a comparison.
    """

    plan: Plan
    scanner: StoredScanner | None
    questions: list[ShownQuestion]


def plan_views(plans: Plans, scanners: Scanners, phantom_id: str, page: PageFrame) -> Iterator[PlanView]:
    """Yield the newest plans with a phantom, judged by the present tolerances."""
    for plan in plans.page(phantom_id=phantom_id, limit=SHOWN).items:
        scanner = _scanner(scanners, plan.scanner_id)
        questions: list[ShownQuestion] = []
        if plan.result is not None and scanner is not None:
            promised = TwoQuestions.of_plan(plan.result, scanner.tolerances)
            questions = shown_pair(promised, page.text, page.formats)
        yield PlanView(plan, scanner, questions)


def _scanner(scanners: Scanners, scanner_id: str) -> StoredScanner | None:
    try:
        return scanners.get(scanner_id)
    except NotFound:
        return None
