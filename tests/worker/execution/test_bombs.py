"""Small files that unpack to gigabytes, read by the product's own processes."""

import threading
from contextlib import suppress
from pathlib import Path
from zipfile import ZIP_DEFLATED, ZipFile

import numpy as np
import pytest
from hostile import checkers, deflated_twice

from sawmill_contracts.geometry import ScannerConstants
from sawmill_contracts.inspections import InspectionOptions
from sawmill_contracts.phantoms import PhantomPicture
from sawmill_contracts.scanners import ScannerSpec
from sawmill_contracts.scans import ScanSpec, ScanState
from sawmill_platform.attempts.limits import DATA_BYTES
from sawmill_platform.contracts.jobs import JobState
from sawmill_vocabulary import DataKind

pytestmark = pytest.mark.slow


def packed_zeros(path: Path, samples: int = 20 * 768 * 15_000) -> None:
    """NPZ of bytes, which are read as a whole and become four times as many."""
    header = {"descr": "|u1", "fortran_order": False, "shape": (20, samples // 20 // 768, 768)}
    with (
        ZipFile(path, "w", ZIP_DEFLATED, compresslevel=1) as archive,
        archive.open("data.npy", "w", force_zip64=True) as file,
    ):
        np.lib.format.write_array_header_1_0(file, header)
        for _ in range(samples // 2**24):
            file.write(bytes(2**24))
        file.write(bytes(samples % 2**24))


def small_scan(path: Path) -> None:
    """Nothing of the kind."""
    with path.open("wb") as file:
        np.save(file, np.ones((20, 1, 768), np.float32))


class Watch(threading.Thread):
    """Looks from outside at the private memory of the product's processes among this one's children."""

    def __init__(self):
        super().__init__(daemon=True)
        self.most = 0
        self.ended = threading.Event()

    def run(self):
        while not self.ended.wait(0.01):
            self.most = max([self.most, *(self._data(child) for child in self._children())])

    @staticmethod
    def _children():
        """Of this process, and of the template among them."""
        found = ["self"]
        for parent in found:
            with suppress(OSError):  # it has ended meanwhile
                found += [
                    pid for task in Path(f"/proc/{parent}/task").glob("*/children") for pid in task.read_text().split()
                ]
        return found[1:]

    @staticmethod
    def _data(pid):
        try:
            command = Path(f"/proc/{pid}/cmdline").read_bytes()
            lines = Path(f"/proc/{pid}/status").read_text().splitlines()
        except OSError:  # it has ended meanwhile
            return 0
        if b"sawmill_worker" not in command:  # of another test, as a browser's driver
            return 0
        return sum(1024 * int(line.split()[1]) for line in lines if line.startswith("VmData"))


@pytest.fixture
def watch():
    thread = Watch()
    thread.start()
    yield thread
    thread.ended.set()


def test_small_files_that_unpack_to_gigabytes_are_refused_once_before_they_are_unpacked(store, reader, watch, tmp_path):
    constants = ScannerConstants(source_to_cor_mm=859.46, num_detector_pixels=768, detector_pitch_mm=1.5)
    scanner = store.scanners.create(ScannerSpec(name="Line 2", constants=constants)).id
    spec = ScanSpec(scanner_id=scanner, data=DataKind.LINE_INTEGRALS, angles_deg="0:18")

    def upload(make):
        make(tmp_path / "bomb")
        data = (tmp_path / "bomb").read_bytes()
        assert len(data) < 2 * 10**6
        return store.files.receive([data], max_bytes=2**24)

    scans = [store.scans.accept(spec, upload(make)) for make in (deflated_twice, packed_zeros)]
    picture = store.phantoms.accept_picture(PhantomPicture(name="checkers", width_mm=400), upload(checkers))
    inspected = store.inspections.accept_file(InspectionOptions(), upload(deflated_twice))
    good = store.scans.accept(spec, upload(small_scan))
    states = [reader.run_next() for _ in range(6)]
    assert states == [JobState.FAILED] * 3 + [JobState.SUCCEEDED] * 2 + [None]
    codes = [store.jobs.get(job_id).failure.code for job_id in (*(scan.job_id for scan in scans), picture.job_id)]
    assert codes == ["unsupported-storage", "too-large", "phantom"]
    assert "packed twice" in store.scans.get(scans[0].id).reason
    assert "packed twice" in store.inspections.get(inspected.id).result.refusal.detail
    assert "a clean drawing" in store.phantoms.get(picture.id).reason
    assert store.scans.get(good.id).state is ScanState.READY
    # The process as it is, with its libraries, and what a refusal takes: all are seen before they are unpacked.
    assert 0 < watch.most < DATA_BYTES / 2
