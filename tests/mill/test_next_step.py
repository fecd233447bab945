"""The next step with a scanner, by its newest calibration, the movement since the active one, and its alarms."""

import math
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from functools import cache
from itertools import product

import pytest
from results import FRAME, THETA, calibration_result, comparison, fixed_pairs_result

from sawmill_contracts.alarms import AlarmKind
from sawmill_contracts.calibrations import CalibrationResult
from sawmill_contracts.fixed_pairs import FixedPairsResult
from sawmill_contracts.reasons import CodedReason
from sawmill_contracts.scanners import Tolerances
from sawmill_mill.anything_moved import AnythingMoved, StandIn
from sawmill_mill.calibration_differences import differences
from sawmill_mill.next_step import Button, next_step, other_step, step_alone
from sawmill_mill.scanner_state import Calibrated, Checked, ScannerState
from sawmill_mill.two_questions import Answer, TwoQuestions
from sawmill_vocabulary.calibration_messages import CalibrationMessage
from sawmill_vocabulary.movement_messages import LogMessage, MovementMessage
from sawmill_vocabulary.pair_messages import PairMessage
from sawmill_vocabulary.scan_messages import EffectMessage

NOON = datetime(2026, 3, 2, 12, 0, tzinfo=UTC)
HOUR = timedelta(hours=1)
LATER = NOON + HOUR
SLIP = CalibrationMessage.EFFECT_FITTED(EffectMessage.SLIP(view=17, slip_mm=2.5, slip_deg=0.3), off_mm=0.26)
IMPRECISE = CalibrationMessage.IMPRECISE(rms_mm=0.05, upper_mm=0.19, allowed_mm=0.1)
LIMITS = {"tolerance_mm": 0.1, "scale_tolerance_percent": 0.5}


def moved(moved_mm, *, against="active"):
    reason = MovementMessage.MOVED(MovementMessage.TURNTABLE(column_mm=2.61), moved_mm=moved_mm, allowed_mm=0.5)
    known = {"calibration_id": against, "reason": reason, "coded_reason": CodedReason.of(reason)}
    return comparison(moved_mm, **known, within_tolerance=moved_mm <= 0.5)


def answer(*reasons, movement=None, **changes):
    """An answer with these reasons, of which movement is the first."""
    first = [] if movement is None or movement["within_tolerance"] else [movement["coded_reason"]]
    coded = [*first, *map(CodedReason.of, reasons)]
    given = {"reasons": [each.sentence for each in coded], "coded_reasons": coded}
    known = {"limits": LIMITS, "rays_verdict": changes.get("verdict", "pass")}
    return CalibrationResult.model_validate(calibration_result(**known | given | {"comparison": movement} | changes))


def compared(moved_mm=0.05, *reasons, against="active", **changes):
    movement = moved(moved_mm, against=against)
    return replace(ACTIVE, newest=Calibrated("newer", NOON, answer(*reasons, movement=movement, **changes)))


def checked(moved_mm=0.05, *, within=True, at=LATER, message=LogMessage.MOVED):
    values = {"moved_mm": moved_mm, "allowed_mm": 0.5, "limit_mm": 0.1, "loss_percent": 12.4}
    reason = message(LogMessage.DETECTOR_SLID(column_mm=-2.12), **values)
    return Checked(at, "active", within, moved_mm, 0.5, CodedReason.of(reason))


ACTIVE = ScannerState(newest=Calibrated("active", NOON, answer()), active_id="active")
OLD = {"verdict": "watch", "limits": None}


@pytest.mark.parametrize(
    ("state", "tone", "word", "button"),
    [
        (ScannerState(scanned=False), "idle", "New", "calibrate"),
        (ScannerState(), "idle", "Never calibrated", "calibrate"),
        (ScannerState(failure="no phantom"), "bad", "Calibration failed", "calibrate"),
        (ACTIVE, "good", "Fine", "none"),
        (replace(ACTIVE, failure="no phantom"), "watch", "Last calibration failed", "calibrate"),
        (replace(ACTIVE, active_id=None), "watch", "Not accepted", "accept"),
        (replace(ACTIVE, active_id="older"), "watch", "Watch", "calibrate"),
        (replace(ACTIVE, alarms=(AlarmKind.SCANNER_QUIET,)), "watch", "Watch", "none"),
        (replace(compared(), alarms=(AlarmKind.DRIFT,)), "watch", "Watch", "accept"),
        (compared(), "good", "Fine", "accept"),
        # From 0.7 of what is allowed on.
        (compared(0.349), "good", "Fine", "accept"),
        (compared(0.35), "watch", "Watch", "accept"),
        (compared(0.66), "bad", "Out of tolerance", "scan-again"),
        (compared(0.66, against="another"), "watch", "Watch", "calibrate"),
        (compared(0.05, SLIP), "watch", "Watch", "scan-again"),
        (compared(0.66, SLIP), "bad", "Out of tolerance", "scan-again"),
        (compared(0.05, IMPRECISE, verdict="watch"), "watch", "Watch", "scan-again"),
        (compared(0.66, IMPRECISE, verdict="fail"), "bad", "Calibration failed", "scan-again"),
        (compared(0.05, scale_uncertainty_percent=0.6), "watch", "Watch", "accept"),
        (replace(ACTIVE, seen=checked()), "good", "Fine", "none"),
        (replace(ACTIVE, seen=checked(0.43)), "watch", "Watch", "calibrate"),
        (replace(ACTIVE, seen=checked(0.16, message=LogMessage.BEYOND_CALIBRATION)), "watch", "Watch", "calibrate"),
        (replace(compared(), seen=checked(0.16, message=LogMessage.BEYOND_CALIBRATION)), "watch", "Watch", "accept"),
        (replace(ACTIVE, seen=checked(0.43, message=LogMessage.CALIBRATE_SOON)), "watch", "Watch", "calibrate"),
        (replace(ACTIVE, seen=checked(0.8, within=False)), "bad", "Out of tolerance", "calibrate"),
        (replace(ACTIVE, seen=checked(0.8, within=False, at=NOON - timedelta(hours=1))), "good", "Fine", "none"),
    ],
)
def test_each_state_has_a_colour_a_word_and_one_button(state, tone, word, button):
    step = next_step(state)
    assert (step.tone, step.word, step.button) == (tone, word, button)
    assert step.needs_somebody is (tone != "good")


def test_the_headline_has_the_number_and_the_limit_and_the_action_begins_with_the_first_thing():
    words = next_step(compared(0.66)).reason.in_words()
    assert words.headline == "Something has moved: 0.66 mm, and 0.50 mm is allowed."
    assert words.action.startswith("Check the turntable first.")
    assert words.details == "The rays moved 0.66 mm RMS. The COR moved +2.61 mm on the detector and the tilt did not."
    slipped = next_step(compared(0.05, SLIP)).reason.in_words()
    assert (slipped.headline[:17], slipped.action[:18]) == ("The phantom moved", "Fasten the phantom")


def test_a_sentence_of_an_earlier_version_stays_english_and_has_no_code():
    step = step_alone(answer(reasons=["h_S is not resolved"], coded_reasons=[], **OLD))
    assert (step.reason.message.value, step.english) == ("look", "h_S is not resolved")
    assert step.reason.parts[0].message is StandIn.EARLIER_VERSION
    unknown = CodedReason(code="of-a-later-version", sentence="A later reason.")
    assert step_alone(answer(coded_reasons=[unknown], **OLD)).english == "A later reason."


def test_movement_that_the_active_calibration_took_up_has_no_colour():
    taken_up = replace(compared(1.4), active_id="newer")
    assert next_step(taken_up).tone == "good"
    assert (taken_up.moved.tone, taken_up.moved.since_active) == ("idle", False)
    assert AnythingMoved.of(taken_up.newest.result, accepted=True).answer is Answer.ACCEPTED


def test_a_check_that_could_not_tell_takes_nothing_back():
    untold = Checked(LATER, "active", within_tolerance=None)
    state = replace(ACTIVE, last_check=untold, seen=checked(0.62, within=False))
    assert state.unseen
    assert next_step(state).word == "Out of tolerance"
    assert not replace(state, last_check=untold._replace(calibration_id="another")).unseen
    assert not replace(state, last_check=checked()).unseen


VERDICTS = {"pass": (), "watch": (IMPRECISE,), "fail": (IMPRECISE,)}
MOVEMENTS = {"none": None, "within": 0.05, "nearly": 0.4, "beyond": 0.66}
LOGS = {"no": None, "within": checked(), "beyond": checked(0.8, within=False)}
IN_USE = {"nothing": None, "it": "newer", "another": "active"}
WALK = list(product(VERDICTS, MOVEMENTS, [(), (SLIP,)], LOGS, IN_USE, [None, "no phantom"], [(), (AlarmKind.DRIFT,)]))


def test_no_state_contradicts_itself():
    """What moved or slipped is never green with Accept, and a scanner that is red is not made green by accepting."""
    for verdict, movement, slip, log, in_use, failure, alarms in WALK:
        compared_with = None if MOVEMENTS[movement] is None else moved(MOVEMENTS[movement])
        result = answer(*slip, *VERDICTS[verdict], movement=compared_with, verdict=verdict)
        newest = Calibrated("newer", NOON, result)
        state = ScannerState(newest, IN_USE[in_use], failure=failure, seen=LOGS[log], alarms=alarms)
        step, third = next_step(state), AnythingMoved.of(result)
        where = (verdict, movement, slip, log, in_use, failure, alarms)
        words = step.reason.in_words()
        assert words.headline, where
        assert words.action, where
        assert "%(" not in words.text, where
        assert step.answer.headline == words.headline, where
        has_moved = movement == "beyond" or bool(slip)
        assert (third.answer in {Answer.LOOK, Answer.NO}) == has_moved, where
        assert (third.answer is Answer.NO, third.slip is not None) == (movement == "beyond", bool(slip)), where
        if step.button is Button.ACCEPT:
            assert step.tone != "bad", where
            assert verdict == "pass", where
            assert not slip, where
            assert movement != "beyond" or in_use != "another", where
            assert in_use != "it", where
        if has_moved and in_use == "another":
            assert (step.tone, step.card_tone, step.button) != ("good", "good", "accept"), where
            assert step.tone != "good", where


def test_an_older_calibration_leads_to_the_newest_and_a_rejected_one_to_the_chosen_one():
    assert {other_step(NOON, LATER, active=active).button for active in (True, False)} == {Button.NEWEST}
    assert other_step(LATER, NOON, active=False).button is Button.CHOSEN
    assert other_step(LATER, NOON, active=False, discarded=True).word == "Discarded"


def test_an_earlier_red_result_keeps_the_colour_and_its_number_until_somebody_decides():
    red, headline = compared(0.66).newest, "Something has moved: 0.66 mm, and 0.50 mm is allowed."
    step = next_step(replace(compared(), red=red))
    assert (step.tone, step.word, step.button) == ("bad", "Out of tolerance", Button.ACCEPT)
    assert step.reason.in_words().headline == f"{headline} The newest calibration does not show it."
    step = next_step(replace(compared(0.05, SLIP), red=red))
    assert (step.tone, step.word, step.button) == ("bad", "Out of tolerance", Button.SCAN_AGAIN)
    log = next_step(replace(compared(), seen=checked(0.8, within=False, at=NOON - timedelta(hours=1))))
    assert (log.tone, log.button) == ("bad", Button.ACCEPT)
    assert log.reason.in_words().headline.startswith("A log shows that something has moved: 0.80 mm")


RESULTS = list(product(VERDICTS, ("within", "beyond")))
CHECKS = ("log within", "log beyond")


@cache
def result_of(result, at, *, active=False, against="active"):
    verdict, movement = result
    compared_with = None if against is None else moved(MOVEMENTS[movement], against=against)
    found = answer(*VERDICTS[verdict], movement=compared_with, verdict=verdict)
    return Calibrated("active" if active else f"at {at}", NOON + at * HOUR, found)


@cache
def step_after(accepted, newest, red, log, log_is_newer):
    """The product's step with the results that are neither discarded nor older than the last acceptance."""
    against = None if accepted is None else "active"
    within, at = log == "log within", NOON + (3 if log_is_newer else 1) * HOUR
    in_use = accepted and result_of(accepted, 0, active=True, against="another")
    return next_step(
        ScannerState(
            newest=in_use if newest is None else result_of(newest, 2, against=against),
            active_id=in_use and in_use.id,
            red=red and result_of(red, 1, against=against),
            seen=log and checked(0.05 if within else 0.8, within=within, at=at),
        )
    )


def tone_and_accept(accepted, events):
    """A plain model: red while a red result or the last log's remains, else by the newest result; who may accept it."""
    results, logs = [each for each in events if each not in CHECKS], [each for each in events if each in CHECKS]
    reds = [verdict == "fail" or (accepted is not None and movement == "beyond") for verdict, movement in results]
    log_is_red = logs[-1:] == ["log beyond"]
    verdict = results[-1][0] if results else accepted and accepted[0]
    unaccepted = bool(results) and accepted is None
    tone = {None: "idle", "pass": "watch" if unaccepted else "good", "watch": "watch", "fail": "bad"}[verdict]
    log_since = bool(events) and events[-1] in CHECKS
    acceptable = bool(results) and verdict == "pass" and not reds[-1] and not (log_since and log_is_red)
    return "bad" if any(reds) or log_is_red else tone, acceptable


def successors(accepted, events):
    """The history after each thing that can happen next: the last acceptance, and what counts since."""
    for each in (*RESULTS, *(CHECKS if accepted else ())):
        yield accepted, (*events, each)
    results = [place for place, each in enumerate(events) if each not in CHECKS]
    if results:
        yield events[results[-1]], ()
    for place in results:
        yield accepted, events[:place] + events[place + 1 :]


def test_every_sequence_of_six_leaves_the_colour_of_a_plain_model():
    histories = reached = {(None, ())}
    for _ in range(6):
        reached = {after for history in reached for after in successors(*history)} - histories
        histories = histories | reached
    for accepted, events in histories:
        results, logs = [each for each in events if each not in CHECKS], [each for each in events if each in CHECKS]
        reds = [each for each in results if each[0] == "fail" or (accepted and each[1] == "beyond")]
        newest = (each[-1] if each else None for each in (results, reds, logs))
        step = step_after(accepted, *newest, events[-1:] == tuple(logs[-1:]))
        assert (step.tone, step.button is Button.ACCEPT) == tone_and_accept(accepted, events), (accepted, events)


PREDICTED = {"rms": 0.02, "max": 0.05, "upper_95": 0.04, "radius_mm": 150.0}


def questions(tolerances=None, **changes):
    answer = calibration_result(**{"limits": LIMITS, "rays_verdict": "pass"} | changes)
    return TwoQuestions.of(CalibrationResult.model_validate(answer), tolerances)


def test_numbers_stand_beside_their_limits_and_the_scale_becomes_mm_on_the_largest_log():
    both = questions()
    assert both.rays.answer is both.millimetres.answer is Answer.YES
    # 0.3 % and 0.5 % of a log of 2 x 150 mm.
    assert both.millimetres.on_diameter_mm == pytest.approx(0.9)
    assert both.millimetres.limit_on_diameter_mm == pytest.approx(1.5)
    assert both.rays.sentence() == "In 95 of 100 cases the rays are off by less than 0.040 mm; 0.100 mm is allowed."
    assert both.millimetres.sentence() == "Sizes are right to 0.3 %: 0.9 mm on a log of 300 mm; 0.5 % is allowed."


@pytest.mark.parametrize(
    ("lost_percent", "stated"), [(4.9, ""), (12.4, " Knots of 10 mm may lose up to 12 % of their contrast.")]
)
def test_what_the_bound_costs_knots_is_stated_from_five_per_cent_on(lost_percent, stated):
    lost = {"contrast_loss": {"knot_10_mm_percent": lost_percent, "mtf_percent": 20.0}}
    assert questions(predicted_ray_error_mm=PREDICTED | lost).rays.sentence() == questions().rays.sentence() + stated


@pytest.mark.parametrize(
    ("changes", "rays", "millimetres"),
    [
        ({"rays_verdict": "watch", "predicted_ray_error_mm": PREDICTED | {"upper_95": 0.2}}, "look", "yes"),
        ({"rays_verdict": "watch"}, "look", "yes"),
        ({"rays_verdict": "fail"}, "no", "yes"),
        ({"predicted_ray_error_mm": None}, "unknown", "yes"),
        ({"scale_uncertainty_percent": 1.2}, "yes", "look"),
        ({"scale_uncertainty_percent": None}, "yes", "unknown"),
        ({"limits": None}, "yes", "unknown"),
        ({"status": "inconsistent-scale", "rays_verdict": "fail"}, "no", "no"),
        ({"status": "not-converged", "rays_verdict": "fail"}, "no", "unknown"),
    ],
)
def test_each_answer_has_a_word_and_a_whole_sentence(changes, rays, millimetres):
    both = questions(**changes)
    assert (both.rays.answer, both.millimetres.answer) == (rays, millimetres)
    for sentence in (both.rays.sentence(), both.millimetres.sentence()):
        assert sentence.endswith(".")
        assert "%(" not in sentence


def test_an_uncertain_scale_of_fixed_pairs_speaks_against_no_ray():
    scale = [CodedReason.of(PairMessage.SCALE(percent=0.7, allowed_percent=0.5, corners_mm=0.1))]
    uncertain = fixed_pairs_result(coded_reasons=scale, upper_95_mm=0.05, scale_uncertainty_percent=0.7)
    both = [TwoQuestions.of_pairs(FixedPairsResult.model_validate(each)) for each in (uncertain, fixed_pairs_result())]
    assert [(one.rays.answer, one.millimetres.answer) for one in both] == [("yes", "look"), ("look", "yes")]


def test_an_answer_of_an_earlier_version_is_held_against_the_scanner():
    both = questions(Tolerances(predicted_ray_error_mm=0.03, scale_percent=0.2), limits=None, rays_verdict=None)
    assert (both.rays.limit_mm, both.rays.within) == (0.03, False)
    assert both.rays.answer is both.millimetres.answer is Answer.LOOK


def test_a_language_gives_its_words_and_its_decimals():
    sentence = questions().rays.sentence
    catalogue = {questions().rays.message: "Säteet: %(bound)s / %(limit)s"}
    said = sentence(words=catalogue.__getitem__, mm=lambda value: f"{value:.3f} mm".replace(".", ","))
    assert said == "Säteet: 0,040 mm / 0,100 mm"


SPREADS = {"theta": dict.fromkeys(THETA, 0.1), "source_frame": dict.fromkeys(FRAME, 0.1)}


def calibration(spreads=SPREADS, **frame):
    return CalibrationResult.model_validate(calibration_result(source_frame=FRAME | frame, standard_deviation=spreads))


def test_a_change_is_certain_beyond_both_error_bars_together():
    moved = calibration(cor_column_mm=FRAME["cor_column_mm"] + 0.3, tilt_rad=FRAME["tilt_rad"] - 0.2)
    found = {each.name: each for each in differences(calibration(), moved)}
    changes = dict.fromkeys(("psi_rad", "source_distance_mm", "source_to_detector_mm"), 0.0)
    changes |= {"cor_column_mm": 0.3, "tilt_rad": -0.2}
    assert {name: each.change for name, each in found.items()} == pytest.approx(changes)
    # 95 % of a normal distribution whose variance is that of both.
    assert found["cor_column_mm"].error == pytest.approx(1.96 * math.sqrt(0.02))
    assert (found["cor_column_mm"].is_certain, found["tilt_rad"].is_certain) == (True, False)


def test_the_first_angle_goes_the_shorter_way_round_and_without_an_error_bar_nothing_is_certain():
    angle, *_ = differences(calibration(psi_rad=0.01), calibration(psi_rad=math.tau - 0.02))
    assert angle.change == pytest.approx(-0.03)
    held = SPREADS | {"source_frame": SPREADS["source_frame"] | {"source_distance_mm": None}}
    of_r = next(each for each in differences(calibration(), calibration(held)) if each.name == "source_distance_mm")
    assert (of_r.error, of_r.is_certain) == (None, None)
