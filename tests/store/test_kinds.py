"""Every kind declares itself, and one store serves those that are asked for, whichever table holds their rows."""

import pytest

from sawmill_contracts import job_kinds
from sawmill_contracts.calibrations import CalibrationAsk
from sawmill_contracts.declared_kinds import asked_kinds
from sawmill_contracts.drifts import DriftAsk
from sawmill_contracts.kinds import AskedKind
from sawmill_contracts.plans import PlanAsk
from sawmill_platform.contracts.jobs import JobKind
from sawmill_platform.contracts.kind_declarations import declaration_of
from sawmill_platform.errors import Conflict, NotFound
from sawmill_store.mill_tables import OWN_TABLES, AskedRow, table_of
from sawmill_vocabulary import Theta

NOMINAL = Theta(
    initial_angle_rad=0.0, detector_to_cor_mm=740.0, source_shift_mm=200.0, detector_shift_mm=30.0, detector_tilt=0.2
)


@pytest.fixture
def calibration(store, ready_scan, finish):
    accepted = store.calibrations.accept(CalibrationAsk(scan_id=ready_scan.id, activate=True))
    finish(store)
    return store.calibrations.get(accepted.id)


@pytest.fixture
def as_new_kinds(monkeypatch):
    """Drift checks and plans as they were stored if they came after the first versions."""
    for kind in (job_kinds.DRIFT, job_kinds.PLAN):
        monkeypatch.delitem(OWN_TABLES, kind)


@pytest.mark.parametrize("kind", JobKind.all())
def test_each_kind_declares_itself_under_its_names(kind):
    declared = declaration_of(kind)
    assert (declared.kind, JobKind.of(kind)) == (kind, kind)
    assert kind.plural.startswith(declared.noun)
    assert declared.processor_s >= 3600


@pytest.mark.parametrize("declared", asked_kinds(), ids=lambda declared: declared.noun)
def test_the_columns_of_an_asked_kind_can_hold_what_it_refers_to(declared: AskedKind):
    columns = table_of(declared.kind).own_columns()
    assert {f"{name}_id" for name in declared.references if name != "theta"} <= columns
    assert set(declared.listed_by) <= columns | {"state"}
    assert declared.files.keys() <= declared.links.model_fields.keys()


@pytest.mark.dialect
@pytest.mark.usefixtures("as_new_kinds")
def test_a_new_kind_s_rows_stand_in_the_common_table(store, scanner, ready_scan, calibration, finish):
    plan = store.plans.accept(PlanAsk(scanner_id=scanner.id, theta=NOMINAL), given={"phantom_id": "l-shape"})
    drift = store.drifts.accept(DriftAsk(scan_id=ready_scan.id, rows="0:1"))
    finish(store)
    finish(store)
    done = store.plans.get(plan.id), store.drifts.get(drift.id)
    assert [item.state for item in done] == ["succeeded", "succeeded"]
    assert done[1].calibration_id == calibration.id
    assert (store.plans.page().items, store.drifts.page(scan_id=ready_scan.id).items) == ([done[0]], [done[1]])
    assert store.drifts.page(scan_id="other").items == []
    with store.database.read() as session:
        assert {row.id for row in session.query(AskedRow)} == {plan.id, drift.id}


@pytest.mark.usefixtures("as_new_kinds")
def test_kinds_that_share_a_table_are_distinguished(store, scanner):
    plan = store.plans.accept(PlanAsk(scanner_id=scanner.id, theta=NOMINAL), given={"phantom_id": "l-shape"})
    assert store.drifts.page().items == []
    with pytest.raises(NotFound, match=f"there is no drift '{plan.id}'"):
        store.drifts.get(plan.id)


@pytest.mark.usefixtures("as_new_kinds", "calibration")
def test_in_the_common_table_too_a_kind_decides_what_stays(store, scanner, ready_scan):
    phantom = store.phantoms.create(store.phantoms.get("l-shape").drawing)
    store.plans.accept(PlanAsk(scanner_id=scanner.id, theta=NOMINAL), given={"phantom_id": phantom.id})
    store.phantoms.delete(phantom.id)
    drift = store.drifts.accept(DriftAsk(scan_id=ready_scan.id))
    with pytest.raises(Conflict, match=f"is needed by job '{drift.job_id}'"):
        store.scans.delete(ready_scan.id)
    store.jobs.request_cancel(drift.job_id)
    store.scans.delete(ready_scan.id)
    with pytest.raises(Conflict, match="is used by 1 calibrations"):
        store.scanners.delete(scanner.id)


def test_the_examples_of_kinds_that_share_a_table_have_different_ids():
    shared = [declared for declared in asked_kinds() if declared.kind not in OWN_TABLES]
    ids = [declared.example_id for declared in shared]
    clashing = [declared.kind.plural for declared in shared if ids.count(declared.example_id) > 1]
    assert not clashing, "name another id in `to_get` of the declaration, as {'level_id': 'example-level'}"
