import pytest

from sawmill_contracts.calibrations import CalibrationAsk
from sawmill_contracts.phantoms import PhantomPicture
from sawmill_contracts.plans import PlanAsk
from sawmill_platform.contracts.jobs import Failure, FailureKind
from sawmill_platform.errors import Conflict, NotFound
from sawmill_vocabulary import Theta

NOMINAL = Theta(
    initial_angle_rad=0.0, detector_to_cor_mm=740.0, source_shift_mm=200.0, detector_shift_mm=30.0, detector_tilt=0.2
)


def traced_later(store):
    received = store.files.receive([b"picture"], max_bytes=10)
    return store.phantoms.accept_picture(PhantomPicture(name="cross", width_mm=400.0), received)


def test_without_a_theta_the_active_calibration_s_is_taken(store, scanner, ready_scan, finish):
    with pytest.raises(Conflict, match="has no active calibration whose theta could be taken: give theta"):
        store.plans.accept(PlanAsk(scanner_id=scanner.id), given={"phantom_id": "l-shape"})
    calibration = store.calibrations.accept(CalibrationAsk(scan_id=ready_scan.id, activate=True))
    finish(store)
    asked = store.plans.accept(PlanAsk(scanner_id=scanner.id), given={"phantom_id": "l-shape"})
    assert asked.options.theta == store.calibrations.get(calibration.id).theta


def test_a_refused_phantom_and_unknown_ones_are_reported(store, scanner):
    phantom = traced_later(store)
    claim = store.jobs.claim("test")
    store.jobs.fail(claim, Failure(kind=FailureKind.INPUT, code="no-picture", detail="there is no wood in it"))
    ask = PlanAsk(scanner_id=scanner.id, theta=NOMINAL)
    with pytest.raises(Conflict, match="cannot be used: there is no wood in it"):
        store.plans.accept(ask, given={"phantom_id": phantom.id})
    with pytest.raises(NotFound, match="there is no phantom 'cube'"):
        store.plans.accept(ask, given={"phantom_id": "cube"})
    with pytest.raises(NotFound, match="there is no scanner 'line-9'"):
        store.plans.accept(PlanAsk(scanner_id="line-9", theta=NOMINAL), given={"phantom_id": "l-shape"})
