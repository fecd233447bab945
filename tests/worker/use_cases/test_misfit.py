"""The remark on a large misfit names the geometry or motion only where they are the cause."""

from dataclasses import replace

import pytest

import sawmill_calibration as sawmill

pytestmark = pytest.mark.slow

SCANNER = sawmill.Scanner(859.46, 192, 6.01146)
THETA = sawmill.Theta(2.55, 714.7, 319.9, 43.7, 0.281)
SHIFTED = replace(THETA, detector_shift_mm=THETA.detector_shift_mm + 15.0)
TILTED = replace(THETA, detector_tilt=THETA.detector_tilt + 0.1)


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
    (remark,) = (each for each in report.remarks if "misses the data" in each)
    assert ("check the geometry" in remark) is displaced
    assert ("beam hardening" in remark) is not displaced


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
    (remark,) = (each for each in report.remarks if "misses the data" in each)
    assert ("check the geometry" in remark) is displaced
    assert ("beam hardening" in remark) is not displaced
