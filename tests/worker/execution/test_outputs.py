"""What an attempt leaves is checked before it is published, whatever it says of it."""

import os

import numpy as np
import pytest
import results
from results import DAMAGES
from scan_files import new_volume

from sawmill_contracts import kinds
from sawmill_contracts.inspections import PICTURE_PX, ScanPicture
from sawmill_contracts.reconstructions import ReconstructionRequest
from sawmill_platform.errors import InvalidOutput
from sawmill_store.subjects.outputs import check_file, output_file

SHAPE = (1, 16, 16)
VOLUME = "entry/reconstruction/data"


@pytest.fixture
def given(store, queue):
    job = queue("succeed")
    results.succeed(store)
    ask = ReconstructionRequest(scan_id=job.subject_id, theta=results.THETA, size=16)
    return store.jobs.handed_over(store.reconstructions.accept(ask).job_id)


@pytest.fixture
def output(tmp_path):
    folder = tmp_path / "data" / "attempts" / "one"
    folder.mkdir()
    with new_volume(folder / "volume.h5", SHAPE) as volume:
        volume.write(0, np.random.default_rng(1).random(SHAPE, np.float32))
    return folder


def check(given, output, **changes):
    answer = results.answer_of(kinds.RECONSTRUCT, results.reconstruction_result(**{"shape": SHAPE} | changes))
    check_file(kinds.RECONSTRUCT, given, answer, output_file(kinds.RECONSTRUCT, output))


def test_what_a_job_of_its_kind_writes_is_taken_and_anything_else_is_not(given, output):
    check(given, output)
    with pytest.raises(InvalidOutput, match=r"the shape \(2, 16, 16\), and \(1, 16, 16\) was asked for"):
        check(given, output, shape=(2, 16, 16))
    with pytest.raises(InvalidOutput, match="and none is due"):
        output_file(kinds.PLAN, output)
    (output / "more").mkdir()
    with pytest.raises(InvalidOutput, match=r"and volume\.h5 is due"):
        check(given, output)


def test_an_inspection_may_leave_one_picture_of_the_right_length(given, tmp_path):
    def check_inspection():
        answer = results.answer_of(kinds.INSPECT, results.inspection_result())
        check_file(kinds.INSPECT, given, answer, output_file(kinds.INSPECT, folder))

    folder = tmp_path / "inspected"
    folder.mkdir()
    assert output_file(kinds.INSPECT, folder) is None
    picture = folder / ScanPicture.VIEW
    picture.write_bytes(bytes(PICTURE_PX**2))
    check_inspection()
    picture.write_bytes(b"<script>")
    with pytest.raises(InvalidOutput, match="it has 8 bytes, not 102400"):
        check_inspection()


@pytest.mark.parametrize("damage", DAMAGES)
def test_a_volume_that_is_not_as_a_job_writes_it_is_refused(given, output, damage):
    DAMAGES[damage](output / "volume.h5", VOLUME)
    with pytest.raises(InvalidOutput):
        check(given, output)


def test_a_file_with_a_second_name_and_a_pipe_are_refused(given, output):
    volume = output / "volume.h5"
    os.link(volume, output.parent / "second")
    with pytest.raises(InvalidOutput, match="a second name"):
        check(given, output)
    (output.parent / "second").unlink()
    volume.chmod(0)
    if os.geteuid():  # root reads all
        with pytest.raises(InvalidOutput, match="nobody may read"):
            check(given, output)
    volume.unlink()
    os.mkfifo(volume)
    with pytest.raises(InvalidOutput, match="a pipe"):
        check(given, output)
