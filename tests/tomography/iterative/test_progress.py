import numpy as np
import pytest

from sawmill_tomography.reconstruction.iterative.progress import Phases, part_of, share_of_descent


def test_phases_share_the_whole_by_their_costs():
    reported = []
    phases = Phases(reported.append, choose=3.0, skipped=0.0, descend=1.0)
    for phase in ("choose", "skipped", "descend"):
        report = phases.of(phase)
        report(0.5)
        report(1.0)
    assert reported == pytest.approx([0.375, 0.75, 0.75, 0.75, 0.875, 1.0])


def test_parts_of_parts_stay_within_the_whole():
    reported = []
    Phases(part_of(reported.append, 0.5, 0.5), one=1.0, other=1.0).of("other")(1.0)
    assert reported == [1.0]
    part_of(None, 0.0, 1.0)(0.3)


def test_the_share_rises_with_every_iteration_and_predicts_the_usual_number_at_first():
    shares = np.array([share_of_descent(done, 300, 60) for done in range(301)])
    assert shares[0] == 0.0
    assert shares[-1] == 1.0
    assert (np.diff(shares) > 0.0).all()
    # After one iteration of sixty: 1 / 60, to the curve's bend.
    assert 1.0 / shares[1] == pytest.approx(60.0, rel=0.02)
    assert shares[60] > 0.7


def test_the_share_of_a_short_descent_follows_its_limit():
    assert share_of_descent(5, 10, 60) == 0.5
