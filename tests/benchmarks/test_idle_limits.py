"""The study of limits that change nothing: it reaches every reader of a limit, and the calibration gains none."""

import idle_limits
import pytest
from idle_limits import limits, scaled
from tests.test_budget import BUDGET

from sawmill_tomography.calibration.joint_fit import fitter, normal_equations, selection, steps, wood_patches
from sawmill_tomography.phantoms.built_in import L_SHAPE


def test_the_calibration_has_at_most_as_many_limits_as_the_budget_allows():
    assert len(list(limits())) <= BUDGET["limits"], "a further limit: which other one does it replace?"


def test_a_limit_is_set_wherever_it_is_read_and_what_was_computed_with_another_is_forgotten():
    known = {limit.label: limit for limit in limits()}
    before, patches = normal_equations.UNTRUSTED, len(wood_patches.wood_patches(L_SHAPE))
    try:
        known["joint_fit.normal_equations.UNTRUSTED"].set(0.4)
        known["joint_fit.wood_patches.PATCHES"].set(30)
        assert fitter.UNTRUSTED == selection.UNTRUSTED == normal_equations.UNTRUSTED == 0.4
        assert len(wood_patches.wood_patches(L_SHAPE)) < patches
    finally:
        known["joint_fit.normal_equations.UNTRUSTED"].set(before)
        known["joint_fit.wood_patches.PATCHES"].set(130)
    assert len(wood_patches.wood_patches(L_SHAPE)) == patches


@pytest.mark.parametrize(
    ("value", "quarter"),
    [(8, 2), (1, 1), (2.0, 0.5), ((4, 2.0), (1, 0.5)), (True, None), ("fit", None), ((), None), ({"a": 1}, None)],
)
def test_numbers_alone_are_set_aside(value, quarter):
    assert scaled(value, 0.25) == quarter


def test_a_limit_that_nothing_reaches_is_idle_and_one_that_decides_is_not(monkeypatch, capsys):
    names = ("joint_fit.steps.MOVED", "joint_fit.metal.ROUNDS")
    monkeypatch.setattr(idle_limits, "limits", lambda: [limit for limit in limits() if limit.label in names])
    monkeypatch.setattr(idle_limits, "outcomes", lambda scans, _: [{"error_mm": 1e6 * steps.MOVED}] * scans)
    monkeypatch.setattr("sys.argv", ["idle_limits.py", "--scans", "2"])
    idle_limits.main()
    printed = capsys.readouterr().out
    assert "joint_fit.steps.MOVED: 2 and 2 of 2 scans" in printed
    assert "2 limits, of which 1 change nothing: joint_fit.metal.ROUNDS" in printed
    monkeypatch.setattr("sys.argv", ["idle_limits.py", "--list"])
    idle_limits.main()
    assert set(capsys.readouterr().out.split()) == set(names)
