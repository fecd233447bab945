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


def causes(report):
    misfits = (each for each in report.coded_remarks if each.code.endswith("misses-data"))
    return [part.code for each in misfits for part in each.parts]


@pytest.mark.parametrize(
    ("physics", "theta", "displaced"),
    [
        ({"beam": {"energy_spread": 0.6}}, THETA, False),
        ({"beam": {"scatter_share": 0.2}}, THETA, False),
        ({"detector": {"blur_mm": 8.0}}, THETA, False),
        ({}, SHIFTED, True),
        ({}, TILTED, True),
        ({"motion": {"slip_mm": 10.0}}, THETA, True),
    ],
    ids=["hardening", "scatter", "blur", "column", "tilt", "slip"],
)
def test_the_named_cause_is_the_true_one(physics, theta, displaced):
    scan = sawmill.simulate_phantom_scan("l-shape", SCANNER, THETA, views=40, physics=physics, seed=2)
    options = {"method": "total_variation", "coupling": "none", "weight": 2000.0, "size": 96, "field_mm": 500.0}
    report = sawmill.reconstruct(scan, theta, **options).result.method
    assert causes(report) == ["misfit-by-displaced-views" if displaced else "misfit-without-displaced-views"]


def test_single_views_that_do_not_fit_are_named_before_causes_of_the_whole_scan():
    scan = sawmill.simulate_phantom_scan("l-shape", SCANNER, THETA, views=40, seed=2)
    exchanged = scan.line_integrals.copy()
    exchanged[[20, 21]] = exchanged[[5, 33]]
    options = {"method": "total_variation", "coupling": "none", "weight": 2000.0, "size": 96, "field_mm": 500.0}
    report = sawmill.reconstruct(replace(scan, line_integrals=exchanged), THETA, **options).result.method
    (remark,) = (part for each in report.coded_remarks for part in each.parts)
    assert (remark.code, remark.values["views"]) == ("misfit-in-few-views", "20-21")


def test_a_wrong_order_of_the_views_never_clears_the_angles():
    scan = sawmill.simulate_phantom_scan("l-shape", SCANNER, THETA, views=40, seed=2)
    wrong = np.concatenate([scan.line_integrals[:20], scan.line_integrals[:19:-1]])
    options = {"method": "total_variation", "coupling": "none", "weight": 2000.0, "size": 96, "field_mm": 500.0}
    report = sawmill.reconstruct(replace(scan, line_integrals=wrong), THETA, **options).result.method
    (remark,) = (part for each in report.coded_remarks for part in each.parts)
    assert remark.code == "misfit-by-displaced-views" or "order" in remark.sentence


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("physics", "theta", "displaced"),
    [
        ({"beam": {"scatter_share": 0.2}}, THETA, False),
        ({}, SHIFTED, True),
        ({"motion": {"slip_mm": 20.0}}, THETA, True),
    ],
    ids=["scatter", "column", "slip"],
)
def test_a_filtered_image_names_the_true_cause_too(physics, theta, displaced):
    scan = sawmill.simulate_phantom_scan("l-shape", SCANNER, THETA, views=90, physics=physics, seed=2)
    report = sawmill.reconstruct(scan, theta, method="fbp", size=192, field_mm=500.0).result.method
    assert causes(report) == ["misfit-by-displaced-views" if displaced else "misfit-without-displaced-views"]
