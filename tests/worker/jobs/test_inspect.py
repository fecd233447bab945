"""An upload is inspected as the command inspects a file, in the words of the service."""

import io

import h5py
import numpy as np
import pytest
from PIL import Image

from sawmill_contracts import kinds
from sawmill_contracts.inspections import PICTURE_PX, InspectionOptions, InspectionResult, ScanPicture
from sawmill_platform.contracts.attempts import JobFailure
from sawmill_vocabulary import DataKind
from sawmill_worker.jobs.running import run

COUNTS = np.random.default_rng(7).integers(1000, 30_000, (12, 1, 8)).astype(np.uint16)


@pytest.fixture
def inspected(store, attempt):
    """The result for a file's bytes."""

    def inspect(content, **options):
        received = store.files.receive([content], max_bytes=10**7)
        store.inspections.accept_file(InspectionOptions(**options), received, name="morning.npz")
        return InspectionResult.model_validate(run(attempt(kinds.INSPECT)))

    return inspect


def npz(**arrays):
    buffer = io.BytesIO()
    np.savez(buffer, **arrays)
    return buffer.getvalue()


def needed(result):
    return [part.field for part in result.missing if part.needed]


def test_what_neither_the_file_carries_nor_was_given_is_named_by_its_field(inspected):
    content = npz(projections=COUNTS, flats=COUNTS[:2])
    result = inspected(content)
    assert (result.file, result.verdict) == ("morning.npz", "incomplete")
    assert (result.reading.shape.views, result.reading.flats, result.reading.angles) == (12, 2, None)
    assert needed(result) == ["angles_deg", "data", "detector_pitch_mm"]
    result = inspected(content, data=DataKind.COUNTS, angles_deg="0.5:30")
    assert (result.reading.angles.first_deg, result.reading.angles.last_deg) == pytest.approx((0.5, 330.5))
    assert needed(result) == ["detector_pitch_mm"]


def test_a_wrong_angle_is_one_sentence(inspected):
    with pytest.raises(JobFailure, match="an angle must be a number of degrees, not 'abc'"):
        inspected(npz(projections=COUNTS), angles_deg="abc")


def test_what_is_no_scan_is_refused_without_a_flag_of_the_command_line(inspected):
    buffer = io.BytesIO()
    Image.fromarray(np.zeros((8, 8), np.uint8)).save(buffer, format="PNG")
    refused = [inspected(content) for content in (buffer.getvalue(), b"a letter to the editor" * 100)]
    assert [result.verdict for result in refused] == ["refused", "refused"]
    assert not any("--" in result.refusal.detail for result in refused)


@pytest.mark.parametrize(("rows", "name"), [(1, ScanPicture.SINOGRAM), (4, ScanPicture.VIEW)])
def test_one_view_of_a_stack_or_the_sinogram_of_a_row_is_drawn(store, attempt, rows, name):
    counts = np.repeat(np.arange(96).reshape(12, 1, 8), rows, axis=1)
    received = store.files.receive([npz(projections=counts, flats=counts[:2])], max_bytes=10**7)
    store.inspections.accept_file(InspectionOptions(), received)
    inspecting = attempt(kinds.INSPECT)
    run(inspecting)
    drawn = np.fromfile(inspecting.output / name, np.uint8).reshape(PICTURE_PX, PICTURE_PX)
    assert (drawn[0, 0], drawn[0, -1] < drawn[-1, -1]) == (0, rows == 1)  # all views, or the first one alone


def test_numbers_that_cannot_be_read_refuse_the_file_at_once(inspected):
    buffer = io.BytesIO()
    with h5py.File(buffer, "w") as file:
        data = file.create_dataset(
            "entry/data/data", data=np.repeat(COUNTS, 4, axis=1), chunks=(1, 4, 8), compression="gzip"
        )
        chunk = data.id.get_chunk_info(0)
    content = bytearray(buffer.getvalue())
    content[chunk.byte_offset : chunk.byte_offset + chunk.size] = bytes(chunk.size)
    result = inspected(bytes(content), dataset="/entry/data/data")
    assert result.verdict == "refused", result
