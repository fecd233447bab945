"""Pages, report, answers for programs and events show the same next step."""

import json
import re
from html import unescape

import pytest
from results import comparison

from sawmill_contracts.reasons import CodedReason
from sawmill_vocabulary.calibration_messages import CalibrationMessage
from sawmill_vocabulary.movement_messages import LogMessage, MovementMessage
from sawmill_vocabulary.scan_messages import EffectMessage

MOVED = MovementMessage.MOVED(MovementMessage.TURNTABLE(column_mm=2.61), moved_mm=0.66, allowed_mm=0.5)
SLIP = CalibrationMessage.EFFECT_FITTED(EffectMessage.SLIP(view=17, slip_mm=2.5, slip_deg=0.3), off_mm=0.26)
IMPRECISE = CalibrationMessage.IMPRECISE(rms_mm=0.05, upper_mm=0.19, allowed_mm=0.1)
DRIFTED = LogMessage.MOVED(LogMessage.DETECTOR_SLID(column_mm=-2.12), moved_mm=0.8, allowed_mm=0.5)
WORDS_FI = {"A log", "Check", "Scan", "The ", "Something", "phantom", "Fasten", "allowed"}


def reasons_of(*reasons):
    coded = [CodedReason.of(each) for each in reasons]
    return {"reasons": [each.sentence for each in coded], "coded_reasons": coded}


def compared(moved_mm, reason):
    return comparison(moved_mm, reason=str(reason), coded_reason=CodedReason.of(reason))


# The newest calibration, a drift check after it, and the button of the step.
STATES = {
    "good": ({"comparison": comparison()}, None, "accept"),
    "moved": ({"comparison": compared(0.66, MOVED), **reasons_of(MOVED)}, None, "scan-again"),
    "slipped": ({"comparison": comparison(), **reasons_of(SLIP)}, None, "scan-again"),
    "imprecise": ({"verdict": "watch", **reasons_of(IMPRECISE), "comparison": comparison()}, None, "scan-again"),
    "wrong": ({"verdict": "fail", **reasons_of(IMPRECISE)}, None, "scan-again"),
    "drifted": ({"comparison": comparison()}, DRIFTED, "calibrate"),
}


def text_of(html: str) -> str:
    return " ".join(unescape(re.sub(r"<[^>]*>", " ", html)).split())


@pytest.mark.parametrize("state", STATES)
def test_pages_report_and_answers_agree_and_are_finnish_for_finns(seeded, worker, state):
    changes, log, button = STATES[state]
    identifier = seeded.post("/v1/calibrations", json={"scan_id": "example"}).json()["id"]
    worker.finish_calibration(**changes)
    if log is not None:
        seeded.post("/v1/drifts", json={"scan_id": "example"})
        coded = CodedReason.of(log)
        worker.finish_drift(ray_change_mm=0.8, within_tolerance=False, reason=coded.sentence, coded_reason=coded)
    step = seeded.get(f"/v1/calibrations/{identifier}/next-step").json()
    assert (step, step["button"]) == (seeded.get("/v1/scanners/example/next-step").json(), button)
    places = ("/", "/scanners/example", f"/calibrate?calibration={identifier}", f"/calibrations/{identifier}/report")
    pages = {path: seeded.get(path).text for path in places}
    for path, html in pages.items():
        assert step["headline"] in text_of(html), path
        assert step["action"] in text_of(html), path
    verdict = pages[f"/calibrate?calibration={identifier}"]
    primary = re.search(r'class="(?:button )?primary large"[^>]*>([^<]*)<', verdict)[1]
    assert primary == {"accept": "Accept", "scan-again": "Scan again", "calibrate": "Calibrate"}[button]
    events = seeded.get("/v1/events?duration_s=0.05&after=0").text
    assert f'"headline":{json.dumps(step["headline"])}' in events.replace('": ', '":')

    # In Finnish, and without a word of English that is not marked as such.
    for path in (*places[:3], f"{places[3]}?language=fi"):
        page = seeded.get(path, headers={"Accept-Language": "fi"}).text
        main = re.search(r"<main.*?</main>", page, re.DOTALL)[0]
        finnish = text_of(re.sub(r'<(\w+)[^>]*lang="en"[^>]*>.*?</\1>', "", main, flags=re.DOTALL))
        assert [word for word in WORDS_FI if word in finnish] == [], path
