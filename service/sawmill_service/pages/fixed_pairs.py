"""`/fixed-pairs`, `/pair-logs`: a scanner of fixed pairs, from the files of all pairs to their places and to logs."""

import math
from typing import Any

from fastapi.responses import HTMLResponse
from pydantic import TypeAdapter

from sawmill_contracts import pair_logs
from sawmill_contracts.fixed_pairs import DECLARATION, FixedPairs, FixedPairsResult
from sawmill_mill.two_questions import TwoQuestions
from sawmill_platform.contracts.base import Identifier
from sawmill_platform.contracts.keys import Scope
from sawmill_service.dependencies import TheSettings, TheStore
from sawmill_service.http.route_rules import Router
from sawmill_service.pages.calibrate.calibrate_questions import usable_phantoms
from sawmill_service.pages.frame.languages import marked
from sawmill_service.pages.frame.page_frame import PageFrame, ThePage
from sawmill_service.pages.frame.verdicts import shown_pair
from sawmill_service.pages.job_words import STATES, stages
from sawmill_store.store import Store
from sawmill_vocabulary import PairedScanner
from sawmill_vocabulary.pair_messages import PairMessage

LISTED, SEARCHED = 10, 200  # calibrations, or a calibration's logs; the newest logs, of which these are some
LEAST_REACH_MM = 100.0  # of the drawings of a log's marks, from the centre
VERDICTS = {
    "pass": ("good", marked("Done")),
    "watch": ("watch", marked("Look at it")),
    "fail": ("bad", marked("Failed")),
}
AGREEMENTS = {
    "agree": ("good", marked("The pairs agree")),
    "disagree": ("bad", marked("A pair has moved")),
    "unknown": ("idle", marked("Not shown")),
}
# Reasons whose remedy is another passage.
PASS_AGAIN = {PairMessage.ROLL_AGAIN, PairMessage.LIES_ALIKE, PairMessage.ORDER_UNCERTAIN}
_SCANNER = TypeAdapter(PairedScanner)

router = Router(include_in_schema=False, reading=Scope.READ)


@router.get("/fixed-pairs")
def fixed_pairs(page: ThePage, store: TheStore, settings: TheSettings) -> HTMLResponse:
    """Take the nominal places and the files, and list the newest calibrations."""
    newest = store.asked(DECLARATION).page(limit=LISTED).items
    before = newest[0] if newest else None
    places = DECLARATION.to_ask.example["body"]["pairs"] if before is None else before.options.pairs
    scanner = _SCANNER.validate_python({"pairs": places})
    return page.answer(
        "fixed_pairs.html",
        newest=newest,
        before=before,
        places=_SCANNER.dump_json(scanner, exclude_defaults=True, indent=2).decode(),
        phantoms=usable_phantoms(store.phantoms),
        states=STATES,
        verdicts=VERDICTS,
        max_bytes=settings.max_upload_bytes,
    )


@router.get("/fixed-pairs/{identifier}")
def calibration(identifier: Identifier, page: ThePage, store: TheStore, settings: TheSettings) -> HTMLResponse:
    """Show how far a calibration is, why it failed, or its answer, and take the files of another passage."""
    found = store.asked(DECLARATION).get(identifier)
    result = found.result
    return page.answer(
        "fixed_pairs_result.html",
        calibration=found,
        stages=stages(page),
        max_bytes=settings.max_upload_bytes,
        again={**found.options.model_dump(mode="json"), "phantom_id": found.phantom_id},
        **({} if result is None else _shown(page, result) | _logs(found, store)),
    )


@router.get("/pair-logs/{identifier}")
def log(identifier: Identifier, page: ThePage, store: TheStore) -> HTMLResponse:
    """Show how far a log is, why it failed, or its marks and whether the pairs agree."""
    found = store.asked(pair_logs.DECLARATION).get(identifier)
    if (result := found.result) is None:
        return page.answer("pair_log.html", log=found, stages=stages(page))
    far = [max([LEAST_REACH_MM, *(1.2 * abs(mark.place_mm[axis]) for mark in result.marks)]) for axis in range(3)]
    tone, reach_mm = AGREEMENTS[result.agreement.state][0], (max(far[:2]), far[2])
    return page.answer("pair_log.html", log=found, tone=tone, reach_mm=reach_mm)


def _logs(calibration: FixedPairs, store: Store) -> dict[str, Any]:
    """Return the newest logs of a calibration, and the request to which the files of another one are added."""
    newest = store.asked(pair_logs.DECLARATION).page(limit=SEARCHED).items
    return {
        "logs": [one for one in newest if one.options.fixed_pairs_id == calibration.id][:LISTED],
        "of_log": {"fixed_pairs_id": calibration.id, "data": calibration.options.data, "inspection_ids": []},
        "agreements": AGREEMENTS,
        "states": STATES,
    }


def _shown(page: PageFrame, result: FixedPairsResult) -> dict[str, Any]:
    """Return what the template shows of an answer."""
    return {
        "degrees": math.degrees(1.0),
        "tone": VERDICTS[result.verdict][0],
        "questions": shown_pair(TwoQuestions.of_pairs(result), page.text, page.formats),
        "pass_again": any(reason.code in PASS_AGAIN for reason in result.coded_reasons),
    }
