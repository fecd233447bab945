"""From a file as read to the sinograms that every job uses, as asked."""

import math
import subprocess
import sys
import textwrap
from dataclasses import replace
from types import SimpleNamespace
from uuid import uuid4

import h5py
import numpy as np
import pytest
from scan_files import read_stored_scan

from sawmill_calibration.scans import prepare as preparing
from sawmill_calibration.scans.prepare import prepare_scan
from sawmill_contracts import kinds
from sawmill_contracts.scans import PrepareOptions
from sawmill_formats.errors import UnreadableScan
from sawmill_formats.input.canonical import CanonicalScan
from sawmill_formats.input.contents import Projections, held
from sawmill_platform.contracts.attempts import JobFailure
from sawmill_platform.contracts.jobs import FailureKind
from sawmill_tomography.geometry.geometry import FanBeamGeometry
from sawmill_tomography.phantoms.log_model import LogModel
from sawmill_tomography.preparing.row_shifts import RowsError
from sawmill_tomography.projection.analytic import DetectorCells, project
from sawmill_vocabulary import DataKind
from sawmill_vocabulary.reading_messages import PreparingMessage
from sawmill_worker.jobs.running import run

VIEWS, ROWS = 36, 44
LOST = 6
PHOTONS, DARK = 20_000.0, 200.0


@pytest.fixture
def exposed(scanner, theta, turn):
    """Counts, flats and darks of a log, the source 5 % weaker than for the flats; cells differ, rows do not."""
    # Round, since cells that differ are told from smooth structure.
    log, rng = replace(LogModel.random(61), waves=((0j,) * 5,) * 5), np.random.default_rng(62)
    geometry, cells = FanBeamGeometry(scanner, theta, turn(VIEWS)), DetectorCells.of(scanner)
    heights = 30.0 + 3.0 * np.arange(ROWS)
    rows = [project(log.slice_at(z).moved(6.0, -4.0), cells, geometry.frame, geometry.angles_rad) for z in heights]
    air = PHOTONS * (1.0 + 0.03 * rng.standard_normal(128))
    counts = rng.poisson(0.95 * air * np.exp(-np.stack(rows, axis=1))) + DARK
    shape = (1, ROWS, 128)
    return tuple(part.astype(np.float32) for part in (counts, np.full(shape, air + DARK), np.full(shape, DARK)))


@pytest.fixture
def prepare(turn, tmp_path):
    """Prepare counts (with flats) or line integrals as asked, and read the file that is made."""

    def of(parts, window=2**20, *, together=(1, 1), rows_missing=False, **options):
        projections, flats, darks = (*parts, None, None)[:3]
        views = held(projections)
        read = CanonicalScan(
            Projections(views.shape, views.read, together),
            turn(VIEWS), flats is not None, flats, darks, 9.0, 3.0, "npz", (), rows_missing,
        )  # fmt: skip
        output = tmp_path / f"{uuid4().hex}.h5"
        done = prepare_scan(
            read, PrepareOptions(**options), output, detector_pitch_mm=9.0, report=lambda _: None, window_bytes=window
        )
        stored = read_stored_scan(output)
        assert done.shape == stored.line_integrals.shape
        with h5py.File(output) as file:
            shifts = file.get("entry/provenance/row_shifts")
            read = {"air_level": stored.air_level, "row_shifts": None if shifts is None else shifts[()]}
        return SimpleNamespace(**vars(done) | read, stack=stored.line_integrals)

    return of


def test_counts_lose_the_sources_drift_and_line_integrals_are_used_as_they_are(prepare, exposed):
    prepared = prepare(exposed)
    raw = prepare(exposed, air="off", faulty_cells="keep")
    assert raw.stack[:, :, :8].mean() == pytest.approx(-np.log(0.95), abs=0.002)
    assert prepared.stack[:, :, :8].mean() == pytest.approx(0.0, abs=0.002)
    assert any("taken out of 44 rows: 0.051 in the mean" in remark for remark in prepared.remarks)
    declared = prepare([raw.stack])
    np.testing.assert_array_equal(declared.stack, raw.stack)
    assert declared.remarks == ()
    assert prepare([raw.stack], air="background").stack[:, :, :8].mean() == pytest.approx(0.0, abs=0.002)


def test_a_bridged_cell_has_no_counts_of_its_own(prepare, exposed):
    exposed[0][:, 3, 64] = 60_000.0
    prepared = prepare(exposed)
    assert np.argwhere(prepared.air_level == 0.0).tolist() == [[3, 64]]
    assert prepared.stack[:, 3, 64].min() > 0.5


@pytest.mark.parametrize("value", [0.0, 65_535.0])
@pytest.mark.parametrize("window", [2**20, 30_000])
def test_views_that_were_never_filled_are_left_out_everywhere(prepare, exposed, value, window):
    """The file ends with views of one value; a small window is read in blocks of a few rows."""
    counts, flats, darks = exposed
    counts[:, :, 3] = DARK
    filled = counts.copy()
    filled[-3:] = value
    whole, part = prepare([counts, flats, darks]), prepare([filled, flats, darks], window)
    assert part.views_left_out == (VIEWS - 3, VIEWS - 2, VIEWS - 1)
    # Of the cells the same one is dead; of the rows none lacks air.
    assert {each.message for each in part.remarks} - {each.message for each in whole.remarks} == {
        PreparingMessage.VIEWS_LEFT_OUT
    }
    # The air of a row is measured over other views: a constant of the size of its noise.
    assert np.abs(part.stack[:-3] - whole.stack[:-3]).max() < 0.02


def test_a_scan_of_line_integrals_leaves_out_the_same_views(prepare, exposed):
    stack = prepare(exposed).stack
    stack[20] = 13.8
    (remark,) = prepare([stack]).remarks
    assert (remark.message, remark.values["views"]) == (PreparingMessage.VIEWS_LEFT_OUT, "20")


def lose_rows(counts):
    """A third of the views without one to six rows, some at the top; and how many there."""
    rng, lost = np.random.default_rng(63), counts.copy()
    top = np.zeros(VIEWS, int)
    for view in rng.permutation(VIEWS)[: VIEWS // 3]:
        gone = rng.integers(1, LOST + 1)
        top[view] = rng.integers(0, gone + 1)
        lost[view] = np.nan
        lost[view, : ROWS - gone] = counts[view, top[view] : ROWS - gone + top[view]]
    return lost, top


def test_views_that_lost_rows_are_aligned_and_keep_the_numbers_of_their_rows(prepare, exposed):
    counts, flats, darks = exposed
    # Rows of the detector differ by 5 %: the flats of a wrong row would leave bands.
    gain = 1.0 + 0.05 * np.random.default_rng(64).standard_normal((ROWS, 1)).astype(np.float32)
    counts, flats = (counts - DARK) * gain + DARK, (flats - DARK) * gain + DARK
    lost, top = lose_rows(counts)
    whole = prepare([counts, flats, darks])
    mended = prepare([lost, flats, darks], rows_missing=True, align_rows="profile")
    there = ~np.isnan(mended.stack[:, :, 0])
    assert mended.stack.shape == whole.stack.shape
    np.testing.assert_array_equal(mended.row_shifts, top)
    np.testing.assert_array_equal(there.sum(axis=1), (~np.isnan(lost[:, :, 0])).sum(axis=1))
    # The air of a row is measured over other views than before: a constant of the size of its noise.
    assert np.abs(mended.stack - whole.stack)[there].max() < 0.02
    np.testing.assert_allclose(mended.air_level, whole.air_level)
    moved = int((top > 0).sum())
    assert f"rows 0:{ROWS} of {ROWS} are in enough views" in mended.remarks[-1]
    assert f"{moved} of {VIEWS} views moved by 0 to {top.max()} whole rows" in mended.remarks[-1]


def test_missing_features_are_reported(prepare, exposed):
    with pytest.raises(RowsError, match="align the rows by their profile"):
        prepare(exposed, align_rows="features")


@pytest.fixture
def upload(send):
    """Accept line integrals (views, rows, detector) of one scanner's, to be prepared as asked."""
    return lambda stack, **asked: send(stack, data=DataKind.LINE_INTEGRALS, angles_deg="5:10", **asked)


def upload_file(send, arrays, **declared):
    """Accept a file of arrays beside its angles, 10 degrees apart from 0 on, whatever is declared of it."""
    return send({"angles_deg": 10.0 * np.arange(VIEWS), **arrays}, **declared)


def test_an_upload_is_prepared_as_asked_and_the_scan_keeps_what_was_done(upload, attempt, prepare, exposed):
    raw = prepare(exposed, air="off", faulty_cells="keep").stack
    raw[3, 0] = np.nan
    upload(raw, align_rows="profile", air="background")
    reading = attempt(kinds.INGEST)
    result = run(reading)
    assert (result["shape"]["rows"], result["usable_rows"]) == (ROWS, [0, ROWS])
    assert "rows 0:44 of 44 are in enough views, 43 of them in all. 0 of 36 views moved" in result["remarks"][-1]
    with h5py.File(reading.output / "scan.h5") as file:
        np.testing.assert_array_equal(file["entry/provenance/row_shifts"], np.zeros(VIEWS))
        assert np.argwhere(file["entry/instrument/detector/rows_present"][()] == 0).tolist() == [[3, 0]]
        assert file["entry/provenance/remarks"][()].decode().splitlines() == result["remarks"]
        assert abs(np.nanmean(file["entry/instrument/detector/data"][:, :, :8])) < 0.002


@pytest.mark.parametrize(("total", "kind"), [(900_000, FailureKind.PASSING), (800_000, FailureKind.INPUT)])
def test_a_scan_that_does_not_fit_on_the_disk_is_refused_before_it_is_read(
    upload, attempt, exposed, full_disk, total, kind
):
    upload(exposed[0])
    reading = attempt(kinds.INGEST)
    full_disk(100_000, size_bytes=total)
    sentence = r"a scan of 36 x 44 x 128 needs up to 0.000811 GB and 0.0001 GB are free"
    with pytest.raises(JobFailure, match=sentence) as full:
        run(reading)
    assert (full.value.kind, full.value.code) == (kind, "disk-full")


def test_reading_reports_how_far_it_is(upload, attempt, exposed, monkeypatch):
    reported = []
    monkeypatch.setattr(preparing, "_within", lambda _, shape: max(1, 2**19 // (4 * math.prod(shape))))
    upload(exposed[1] - exposed[0], align_rows="profile", air="background")
    with pytest.raises(JobFailure):
        run(attempt(kinds.INGEST, reported))
    fractions = [progress.fraction for progress in reported]
    assert fractions == sorted(fractions)
    assert {progress.stage for progress in reported} == {"read", "prepare", "align rows"}
    assert len(reported) >= 4


# A row of all views is 18 KiB, a view 22 KiB. The pieces say how the file can be read: row by row, or view by view.
@pytest.mark.parametrize(
    ("together", "window", "align_rows"),
    [
        pytest.param((1, 1), 2**16, "profile", marks=pytest.mark.nightly),
        pytest.param((1, ROWS), 2**16, "off", marks=pytest.mark.nightly),
        ((1, ROWS), 2**16, "profile"),
        ((3, 7), 2**13, "profile"),
        ((1, ROWS), 1, "off"),
    ],
)
def test_block_by_block_a_scan_becomes_what_it_becomes_at_once(prepare, exposed, together, window, align_rows):
    counts, flats, _ = exposed
    counts[:, 3, 64] = 60_000.0
    counts[5, 7, 30] = 0.0
    flats[:, 9, 20] = 0.0
    asked = {"rings": "sorting", "align_rows": align_rows, "rows_missing": align_rows != "off"}
    if align_rows != "off":
        counts[1::2, :3] = 0.0
        counts[::2, -2:] = 0.0
    whole = prepare(exposed, **asked)
    apart = prepare(exposed, window, together=together, **asked)
    np.testing.assert_array_equal(apart.stack, whole.stack)
    np.testing.assert_array_equal(apart.air_level, whole.air_level)
    np.testing.assert_array_equal(apart.row_shifts, whole.row_shifts)
    assert apart.remarks == whole.remarks
    assert len(whole.remarks) >= 5
    of_all = whole.stack[:, ~np.isnan(whole.stack[:, :, 0]).any(axis=0)]
    np.testing.assert_array_equal(prepare([of_all, None, None], window, together=together).stack, of_all)


@pytest.mark.parametrize("together", [(1, 1), (1, ROWS)])
def test_a_block_that_cannot_be_used_leaves_nothing_behind(prepare, exposed, tmp_path, together):
    exposed[0][30, 40, 5] = np.inf
    with pytest.raises(UnreadableScan, match="view 30, row 40, cell 5 is inf"):
        prepare(exposed, 2**16, together=together)
    assert list(tmp_path.glob("*h5*")) == []


@pytest.mark.parametrize(
    ("declared", "code", "sentence"),
    [
        ({"phantom_rows": "40:45"}, "rows-outside", "phantom_rows is 40:45, but the file has rows 0:44 only"),
        ({"angles_deg": "0,1,2"}, "angles-mismatch", "3 angles were given for 36 views"),
        ({"angles_deg": "0:2"}, "contradiction", "view 1 is at 10 degrees and the angles given say 2"),
        ({"axes": "cells,views"}, "contradiction", "it must name views, rows, cells"),
        ({"data": "line-integrals"}, "contradiction", "declared line integrals but the file carries flat"),
        ({"data": "counts", "dataset": "nothing"}, "dataset-missing", "no array named 'nothing'; it holds"),
    ],
)
def test_what_was_declared_with_an_upload_and_contradicts_its_file(send, attempt, exposed, declared, code, sentence):
    flats, darks = exposed[1:]
    upload_file(send, {"projections": exposed[0], "flats": flats, "darks": darks}, **({"data": "counts"} | declared))
    with pytest.raises(JobFailure, match=sentence) as refusal:
        run(attempt(kinds.INGEST))
    assert refusal.value.code == code


def test_line_integrals_declared_as_counts_have_no_signal(send, attempt, prepare, exposed):
    raw = prepare(exposed, air="off", faulty_cells="keep").stack
    upload_file(send, {"projections": raw, "flats": exposed[1], "darks": exposed[2]}, data="counts")
    with pytest.raises(JobFailure, match="samples of the scan are not above the dark field") as refusal:
        run(attempt(kinds.INGEST))
    assert refusal.value.code == "counts"


def test_a_log_without_features_along_it_is_refused_by_the_job(upload, attempt, prepare, exposed):
    even = np.repeat(prepare(exposed).stack[:, :1], ROWS, axis=1)
    upload(even + 0.01 * np.random.default_rng(64).standard_normal(even.shape), align_rows="profile")
    with pytest.raises(JobFailure, match=r"[Tt]he log varies too little") as failure:
        run(attempt(kinds.INGEST))
    assert failure.value.code == "rows-not-aligned"


@pytest.mark.slow
def test_memory_holds_the_window_and_not_the_scan(tmp_path):
    # In a process of its own: 307 MB of counts of which no row can be read alone, in a window of 32 MiB.
    program = f"""
        import re, numpy
        from pathlib import Path
        from sawmill_contracts.scans import PrepareOptions
        from sawmill_formats.input.canonical import CanonicalScan
        from sawmill_formats.input.contents import Projections
        from sawmill_calibration.scans.prepare import prepare_scan

        def largest():
            return int(re.search(r"VmHWM:\\s+(\\d+)", Path("/proc/self/status").read_text())[1]) / 1024

        shape, flats = (100, 1000, 768), numpy.full((1, 1000, 768), 2.0, "f4")
        def views(at, rows):
            return numpy.ones((at.stop - at.start, rows.stop - rows.start, 768), "f4")
        angles = numpy.arange(100.0) / 16.0
        read = CanonicalScan(Projections(shape, views, (1, 1000)), angles, True, flats, None, 1.0, None, "hdf5", ())
        reported, before = [], largest()
        prepare_scan(read, PrepareOptions(air="off", faulty_cells="keep"), Path({str(tmp_path / "scan.h5")!r}),
                     detector_pitch_mm=1.0, report=reported.append, window_bytes=32 * 2**20)
        print(len(reported), largest() - before)
        """
    done = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(program)], capture_output=True, text=True, check=True, timeout=120
    )
    blocks, grown_mib = done.stdout.split()
    assert int(blocks) > 15
    # 89: the window, its masks, the flat field in double precision, and what the libraries set up. The scan is 293.
    assert float(grown_mib) < 146
    with h5py.File(tmp_path / "scan.h5") as file:
        # Blocks are of ten views: no chunk is written twice.
        assert file["entry/instrument/detector/data"].chunks == (10, 1, 768)
    stored = read_stored_scan(tmp_path / "scan.h5", slice(998, 1000)).line_integrals
    np.testing.assert_allclose(stored, np.log(2.0), rtol=1e-6)
