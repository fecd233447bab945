"""From a file as read to the sinograms that every job uses, as asked."""

import io

import h5py
import numpy as np
import pytest

from worker.contracts.base import DataKind
from worker.contracts.jobs import JobKind
from worker.contracts.preparing import PrepareOptions
from worker.contracts.scans import ScanSpec
from worker.formats.canonical import CanonicalScan
from worker.tasks import ingest as ingesting
from worker.tasks.failures import JobFailure
from worker.tasks.line_integrals import as_line_integrals
from worker.tasks.running import run
from worker.tomography.analytic import DetectorCells, project
from worker.tomography.geometry import FanBeamGeometry
from worker.tomography.log_model import LogModel
from worker.tomography.preparing.missing_rows import RowsError

VIEWS, ROWS = 36, 44
LOST = 6
PHOTONS, DARK = 20_000.0, 200.0


@pytest.fixture
def exposed(scanner, theta, turn):
    """Counts, flats and darks of a log, the source 5 % weaker than for the flats; cells differ, rows do not."""
    log, rng = LogModel.random(61), np.random.default_rng(62)
    geometry, cells = FanBeamGeometry(scanner, theta, turn(VIEWS)), DetectorCells.of(scanner)
    heights = 30.0 + 3.0 * np.arange(ROWS)
    rows = [project(log.slice_at(z), cells, geometry.frame, geometry.angles_rad, rays_per_cell=1) for z in heights]
    air = PHOTONS * (1.0 + 0.03 * rng.standard_normal(128))
    counts = rng.poisson(0.95 * air * np.exp(-np.stack(rows, axis=1))) + DARK
    shape = (1, ROWS, 128)
    return tuple(part.astype(np.float32) for part in (counts, np.full(shape, air + DARK), np.full(shape, DARK)))


@pytest.fixture
def read(turn):
    def of(projections, flats=None, darks=None, *, rows_missing=False):
        counts = flats is not None
        return CanonicalScan(projections.copy(), turn(VIEWS), counts, flats, darks, 9.0, 3.0, "npz", (), rows_missing)

    return of


def test_counts_lose_the_sources_drift_and_line_integrals_are_used_as_they_are(read, exposed):
    prepared = as_line_integrals(read(*exposed), PrepareOptions())
    raw = as_line_integrals(read(*exposed), PrepareOptions(air="off", faulty_cells="keep"))
    assert raw.stack[:, :, :8].mean() == pytest.approx(-np.log(0.95), abs=0.002)
    assert prepared.stack[:, :, :8].mean() == pytest.approx(0.0, abs=0.002)
    assert any("taken out of 44 rows: 0.051 in the mean" in remark for remark in prepared.remarks)
    declared = as_line_integrals(read(raw.stack.copy()), PrepareOptions())
    np.testing.assert_array_equal(declared.stack, raw.stack)
    assert declared.remarks == ()
    asked = as_line_integrals(read(raw.stack), PrepareOptions(air="background"))
    assert asked.stack[:, :, :8].mean() == pytest.approx(0.0, abs=0.002)


@pytest.mark.parametrize("counts", [True, False])
def test_what_was_read_is_overwritten_where_it_can_be(read, exposed, counts):
    parts = exposed if counts else exposed[:1]
    mine, of_the_file = read(*parts), read(*parts)
    of_the_file.projections.setflags(write=False)
    options = PrepareOptions(air="background", faulty_cells="keep")
    prepared, apart = as_line_integrals(mine, options), as_line_integrals(of_the_file, options)
    assert np.shares_memory(prepared.stack, mine.projections)
    np.testing.assert_array_equal(of_the_file.projections, exposed[0])
    np.testing.assert_array_equal(apart.stack, prepared.stack)


def test_a_bridged_cell_has_no_counts_of_its_own(read, exposed):
    exposed[0][:, 3, 64] = 60_000.0
    prepared = as_line_integrals(read(*exposed), PrepareOptions())
    assert np.argwhere(prepared.air_level == 0.0).tolist() == [[3, 64]]
    assert prepared.stack[:, 3, 64].min() > 0.5


def test_views_that_lost_rows_are_laid_over_one_another(read, exposed):
    counts, flats, darks = exposed
    lost = np.full_like(counts, np.nan)
    top, bottom = np.random.default_rng(63).integers(0, LOST, (2, VIEWS))
    for view in range(VIEWS):
        kept = ROWS - top[view] - bottom[view]
        lost[view, :kept] = counts[view, top[view] : top[view] + kept]
    whole = as_line_integrals(read(counts.copy(), flats, darks), PrepareOptions()).stack
    mended = as_line_integrals(read(lost, flats, darks, rows_missing=True), PrepareOptions(align_rows="profile"))
    assert mended.stack.shape[1] == ROWS - top.max() - bottom.max()
    assert mended.air_level.shape == mended.stack.shape[1:]
    same = whole[:, top.max() : ROWS - bottom.max()]
    # The air of a row is measured over other views than before: a constant of the size of its noise.
    assert np.abs(mended.stack - same).max() < 0.02
    assert "views laid over one another by their profile: " in mended.remarks[-1]
    assert "whole rows" in mended.remarks[-1]
    np.testing.assert_array_equal(mended.row_shifts, top - top.min())


def test_features_that_are_not_there_are_said_to_be_missing(read, exposed):
    with pytest.raises(RowsError, match="align the rows by their profile"):
        as_line_integrals(read(*exposed), PrepareOptions(align_rows="features"))


@pytest.fixture
def upload(store, spec):
    """Accept line integrals (views, rows, detector) of one scanner's, to be prepared as said."""
    scanner = store.scanners.create(spec(), scanner_id="line-2")

    def accept(stack, **said):
        buffer = io.BytesIO()
        np.save(buffer, stack.astype(np.float32))
        received = store.files.receive([buffer.getvalue()], max_bytes=10**8)
        told = ScanSpec(scanner_id=scanner.id, data=DataKind.LINE_INTEGRALS, angles_deg="5:10", **said)
        return store.scans.accept(told, received)

    return accept


def test_an_upload_is_prepared_as_said_and_the_scan_keeps_what_was_done(upload, attempt, read, exposed):
    raw = as_line_integrals(read(*exposed), PrepareOptions(air="off", faulty_cells="keep")).stack
    raw[3, 0] = np.nan
    upload(raw, align_rows="profile", air="background")
    reading = attempt(JobKind.INGEST)
    result = run(reading)
    assert result["shape"]["rows"] == ROWS - 1
    assert result["remarks"][-1].startswith("views laid over one another by their profile: 43 of 44 rows are in all")
    with h5py.File(reading.output / "scan.h5") as file:
        np.testing.assert_array_equal(file["entry/provenance/row_shifts"], np.zeros(VIEWS))
        assert file["entry/provenance/remarks"][()].decode().splitlines() == result["remarks"]
        assert abs(file["entry/instrument/detector/data"][:, :, :8].mean()) < 0.002


def test_an_upload_larger_than_the_free_memory_is_refused(upload, attempt, exposed, monkeypatch):
    needed = exposed[0].size * 4
    monkeypatch.setattr(ingesting, "memory_available", lambda: needed)
    upload(exposed[0])
    with pytest.raises(JobFailure, match=rf"needs {needed} bytes .* upload fewer rows") as failure:
        run(attempt(JobKind.INGEST))
    assert failure.value.code == "too-large"


def test_a_log_without_features_along_it_is_refused_by_the_job(upload, attempt, read, exposed):
    even = np.repeat(as_line_integrals(read(*exposed), PrepareOptions()).stack[:, :1], ROWS, axis=1)
    upload(even + 0.01 * np.random.default_rng(64).standard_normal(even.shape), align_rows="profile")
    with pytest.raises(JobFailure, match=r"[Tt]he log varies too little") as failure:
        run(attempt(JobKind.INGEST))
    assert failure.value.code == "rows-not-aligned"
