import pytest

from sawmill_contracts import kinds
from sawmill_contracts.phantoms import PhantomDrawing
from sawmill_contracts.plans import PlanAsk, PlanResult
from sawmill_platform.contracts.attempts import JobFailure
from sawmill_platform.contracts.jobs import FailureKind
from sawmill_platform.errors import NotFound
from sawmill_tomography.calibration.planning import plan
from sawmill_tomography.geometry.geometry import FanBeamGeometry
from sawmill_tomography.phantoms.built_in import L_SHAPE
from sawmill_vocabulary import Disc
from sawmill_worker.jobs.running import run


@pytest.fixture
def asked(store, spec, theta):
    """Ask for a plan on one scanner."""
    store.scanners.create(spec(), scanner_id="line-2")
    ask = PlanAsk(scanner_id="line-2", theta=theta, views=30, noise=0.01)
    return lambda phantom_id: store.plans.accept(ask, given={"phantom_id": phantom_id})


def test_a_plan_answers_with_the_precision_to_expect(asked, attempt, finish, store, scanner, theta, turn):
    accepted = asked("l-shape")
    planning = attempt(kinds.PLAN)
    answer = run(planning)
    result = PlanResult.model_validate(answer)
    expected = plan(FanBeamGeometry(scanner, theta, turn(30)), L_SHAPE, noise=0.01)
    assert result.predicted_ray_error_mm.rms == expected.predicted_ray_error.rms_mm
    assert result.standard_deviation.source_frame.magnification == expected.frame_deviation[5]
    assert result.standard_deviation.theta.source_shift_mm == expected.theta_deviation[2]
    assert list(planning.output.iterdir()) == []
    finish(planning, answer)
    assert store.plans.get(accepted.id).result == result


def test_a_phantom_that_cannot_calibrate_is_the_asker_s_to_mend(asked, attempt, store):
    disc = PhantomDrawing(name="disc", shapes=[Disc(center_mm=(0, 0), radius_mm=50)])
    asked(store.phantoms.create(disc).id)
    with pytest.raises(JobFailure, match="looks the same from every side") as failure:
        run(attempt(kinds.PLAN))
    assert (failure.value.kind, failure.value.code) == (FailureKind.INPUT, "phantom")


def test_with_a_phantom_deleted_meanwhile_there_is_nothing_to_hand_over(asked, attempt, store):
    phantom = store.phantoms.create(store.phantoms.get("l-shape").drawing)
    asked(phantom.id)
    store.phantoms.delete(phantom.id)
    with pytest.raises(NotFound, match="there is no phantom"):
        attempt(kinds.PLAN)
