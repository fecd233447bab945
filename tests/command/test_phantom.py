"""`sawmill phantom plan` and `sawmill phantom draw`."""

import json
import math
import xml.etree.ElementTree as ET

import pytest

from sawmill_contracts.plans import PlanResult

THETA = ("--theta", "2.55,714.7,319.9,43.7,0.281")


def test_a_plan_compares_phantoms_at_numbers_of_views(run):
    flags = ("--views", 20, "--views", 90, "--noise", 0.01, "--json")
    answer = json.loads(run("phantom", "plan", "l-shape", "rectangle-with-hole", *THETA, *flags).stdout)
    assert answer["state"] == "succeeded"
    plans = [PlanResult.model_validate(each) for each in answer["plans"]]
    assert [(each.phantom, each.views) for each in plans] == [
        ("L-shape", 20),
        ("L-shape", 90),
        ("Rectangle with hole", 20),
        ("Rectangle with hole", 90),
    ]
    rays = [each.predicted_ray_error_mm.rms for each in plans]
    assert rays[1] < rays[0] < rays[2]
    assert all(each.noise == 0.01 and each.views_cut_off == 0 for each in plans)


def test_theta_s_angles_may_be_given_in_degrees(run):
    flags = ("--views", 20, "--json")
    in_degrees = json.loads(run("phantom", "plan", "l-shape", "--theta", "45deg,700,0,0,-45deg", *flags).stdout)
    in_radians = json.loads(run("phantom", "plan", "l-shape", "--theta", f"{math.pi / 4},700,0,0,-1", *flags).stdout)
    assert in_degrees["plans"][0]["theta"] == pytest.approx(in_radians["plans"][0]["theta"])


def test_a_plan_is_a_table_for_people(run):
    shown = run("phantom", "plan", "l-shape", *THETA).stdout
    assert "L-shape" in shown
    assert "rays mm" in " ".join(shown.split())


def test_a_shadow_beyond_the_detector_is_reported(run):
    reported = run("phantom", "plan", "l-shape", *THETA, "--detector-pixels", 256, "--views", 20)
    assert "of 20 views reach an end of the detector" in reported.stderr


@pytest.mark.parametrize(
    ("flags", "complaint"),
    [
        (("cube", *THETA), "'PHANTOM...': must be l-shape"),
        (("l-shape", "--theta", "1,2"), "'--theta': must be five numbers"),
        (("l-shape", "--theta", "10 deg,2deg,3,4,5"), "'--theta': must be five numbers"),
        (("l-shape", "--theta", "10deg,700,0,0,90deg"), "detector_tilt"),
        (("l-shape", *THETA, "--noise", 0), "'--noise': must be above 0 and at most 1, not 0.0"),
        (("l-shape", *THETA, "--views", 2), "--views"),
    ],
)
def test_wrong_use_is_refused(wrong_use, flags, complaint):
    assert complaint in wrong_use("phantom", "plan", *flags)


def test_a_drawing_is_svg_in_mm(run, tmp_path):
    run("phantom", "draw", "rectangle-with-hole", "-o", tmp_path / "drawing.svg")
    root = ET.parse(tmp_path / "drawing.svg").getroot()  # noqa: S314 - our own text
    assert root.tag == "{http://www.w3.org/2000/svg}svg"
    assert root.get("width").endswith("mm")
    assert "Rectangle with hole" in [element.text for element in root.iter()]
