"""The remark on a large misfit names the geometry or motion only where they are the cause."""

from dataclasses import replace

import numpy as np
import pytest

import sawmill_calibration as sawmill

pytestmark = pytest.mark.slow

SCANNER = sawmill.Scanner(859.46, 192, 6.01146)
THETA = sawmill.Theta(2.55, 714.7, 319.9, 43.7, 0.281)
SHIFTED = replace(THETA, detector_shift_mm=THETA.detector_shift_mm + 15.0)
TILTED = replace(THETA, detector_tilt=THETA.detector_tilt + 0.1)


ITERATIVE = {"method": "total_variation", "coupling": "none", "weight": 2000.0, "size": 96, "field_mm": 500.0}
FILTERED = {"method": "fbp", "size": 192, "field_mm": 500.0}


@pytest.fixture(scope="module")
def scan():
    return sawmill.simulate_phantom_scan("l-shape", SCANNER, THETA, views=40, seed=2)


def remarks(scan, theta=THETA, **options):
    report = sawmill.reconstruct(scan, theta, **options).result.method
    return [part for each in report.coded_remarks if each.code.endswith("misses-data") for part in each.parts]


@pytest.mark.parametrize(
    ("views", "options", "physics", "theta", "displaced"),
    [
        (40, ITERATIVE, {"beam": {"energy_spread": 0.6}}, THETA, False),
        (40, ITERATIVE, {"beam": {"scatter_share": 0.2}}, THETA, False),
        (40, ITERATIVE, {"detector": {"blur_mm": 8.0}}, THETA, False),
        (40, ITERATIVE, {}, SHIFTED, True),
        (40, ITERATIVE, {}, TILTED, True),
        (40, ITERATIVE, {"motion": {"slip_mm": 10.0}}, THETA, True),
        pytest.param(90, FILTERED, {"beam": {"scatter_share": 0.2}}, THETA, False, marks=pytest.mark.nightly),
        pytest.param(90, FILTERED, {}, SHIFTED, True, marks=pytest.mark.nightly),
        pytest.param(90, FILTERED, {"motion": {"slip_mm": 20.0}}, THETA, True, marks=pytest.mark.nightly),
    ],
    ids=["hardening", "scatter", "blur", "column", "tilt", "slip", "fbp scatter", "fbp column", "fbp slip"],
)
def test_the_named_cause_is_the_true_one(views, options, physics, theta, displaced):
    scan = sawmill.simulate_phantom_scan("l-shape", SCANNER, THETA, views=views, physics=physics, seed=2)
    (remark,) = remarks(scan, theta, **options)
    assert remark.code == ("misfit-by-displaced-views" if displaced else "misfit-without-displaced-views")


def test_single_views_are_named_before_causes_of_the_whole_scan_and_a_wrong_order_clears_no_angles(scan):
    exchanged = scan.line_integrals.copy()
    exchanged[[20, 21]] = exchanged[[5, 33]]
    (remark,) = remarks(replace(scan, line_integrals=exchanged), **ITERATIVE)
    assert (remark.code, remark.values["views"]) == ("misfit-in-few-views", "20-21")
    wrong = np.concatenate([scan.line_integrals[:20], scan.line_integrals[:19:-1]])
    (remark,) = remarks(replace(scan, line_integrals=wrong), **ITERATIVE)
    assert remark.code == "misfit-by-displaced-views" or "order" in remark.sentence
