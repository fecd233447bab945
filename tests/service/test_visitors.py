"""Whoever may only look finds no buttons on the pages, and cannot press them."""

import pytest
from asgi import refusal

from sawmill_contracts.plans import PlanAsk
from sawmill_platform.contracts.keys import Scope

# A page: what it hides from a key to read, what it says to it, and what the key may not press.
PAGES = {
    "/jobs": (["Yes, cancel it"], "", ["/jobs/{job}/cancel"]),
    "/phantoms/new": ([], "Your key may only look", ["/phantoms/preview"]),
    "/phantoms/l-shape": (["Measure it again", "Compute the plan"], "", ["/phantoms/l-shape/delete"]),
    "/scanners/example": (["/calibrate?scanner=example"], "", ["/scanners/example/settings"]),
    "/scans/example": (
        *(["/scans/example/reconstruct", "/scans/example/delete"], ""),
        ["/scans/example/reconstruct", "/scans/example/delete"],
    ),
    "/calibrate": (['type="file"'], "Your key may only look", ["/calibrate", "/calibrate/dataset"]),
}


@pytest.mark.parametrize("page", PAGES)
def test_whoever_may_only_look_finds_no_buttons_and_cannot_press_them(seeded, store, page):
    plan = store.plans.accept(PlanAsk(scanner_id="example"), given={"phantom_id": "l-shape"})
    hidden, said, forms = PAGES[page]
    shown = seeded.get(page).text
    assert [text for text in hidden if text not in shown] == [], "who may press them has them"
    seeded.bring(Scope.READ)
    shown = seeded.get(page).text
    assert said in shown
    assert [text for text in hidden if text in shown] == []
    for form in forms:
        assert refusal(seeded.post(form.format(job=plan.job_id), json={"shapes": []})) == (403, "scope-too-small")
