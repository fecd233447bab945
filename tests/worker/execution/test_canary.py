"""Files that point at others: what these hold never comes out, and those who sent good ones wait for nobody."""

import stat
from pathlib import Path
from zipfile import ZipFile, ZipInfo

import h5py
import numpy as np
import pytest
import tifffile

from sawmill_contracts.geometry import ScannerConstants
from sawmill_contracts.scanners import ScannerSpec
from sawmill_contracts.scans import ScanSpec, ScanState
from sawmill_platform.contracts.jobs import JobState
from sawmill_vocabulary import DataKind

pytestmark = pytest.mark.slow

SHAPE = (20, 1, 768)
# A line integral that no other file has; the canonical file stores single precision.
CANARY = np.float32(3.1415928)
CANARY_BYTES = CANARY.tobytes() * 8
OME = (
    '<OME xmlns="http://www.openmicroscopy.org/Schemas/OME/2016-06" UUID="urn:uuid:1"><Image ID="Image:0"><Pixels '
    'ID="Pixels:0" DimensionOrder="XYCZT" Type="float" SizeX="768" SizeY="1" SizeC="1" SizeZ="20" SizeT="1">'
    '<TiffData><UUID FileName="{}">urn:uuid:2</UUID></TiffData></Pixels></Image></OME>'
)


@pytest.fixture
def canaries(tmp_path):
    """What is pointed at: files that would be read gladly if they were uploaded."""
    stack = np.full(SHAPE, CANARY)
    np.save(tmp_path / "canary.npy", stack)
    tifffile.imwrite(tmp_path / "canary.tif", stack)
    with h5py.File(tmp_path / "canary.h5", "w") as file:
        file["data"] = stack
    (tmp_path / "canary.raw").write_bytes(stack.tobytes())
    return tmp_path


def linked(path, canaries):
    with h5py.File(path, "w") as file:
        file["data"] = h5py.ExternalLink(str(canaries / "canary.h5"), "data")


def linked_from_matlab(path, canaries):
    with h5py.File(path, "w", userblock_size=512) as file:
        file["data"] = h5py.ExternalLink(str(canaries / "canary.h5"), "data")
    with path.open("r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM")


def stored_elsewhere(path, canaries):
    raw = canaries / "canary.raw"
    with h5py.File(path, "w") as file:
        file.create_dataset("data", SHAPE, np.float32, external=[(str(raw), 0, raw.stat().st_size)])


def virtual(path, canaries):
    layout = h5py.VirtualLayout(SHAPE, np.float32)
    layout[:] = h5py.VirtualSource(str(canaries / "canary.h5"), "data", SHAPE)
    with h5py.File(path, "w") as file:
        file.create_virtual_dataset("data", layout)


def symbolic(path, canaries):
    entry = ZipInfo("data.npy")
    entry.create_system, entry.external_attr = 3, (stat.S_IFLNK | 0o777) << 16
    with ZipFile(path, "w") as archive:
        archive.writestr(entry, str(canaries / "canary.npy"))


def named_in_ome(path, canaries):
    tifffile.imwrite(path, np.ones((1, 768), np.float32), description=OME.format(canaries / "canary.tif"))


def good(path, _):
    with path.open("wb") as file:
        np.save(file, np.ones(SHAPE, np.float32))


POINTING = (linked, linked_from_matlab, stored_elsewhere, virtual, symbolic, named_in_ome)


def everything_in(folder: Path) -> bytes:
    return b"".join(path.read_bytes() for path in folder.rglob("*") if path.is_file())


def test_nothing_comes_out_of_a_file_that_an_upload_points_at(store, reader, canaries, tmp_path, capfd):
    constants = ScannerConstants(source_to_cor_mm=859.46, num_detector_pixels=768, detector_pitch_mm=1.5)
    scanner = store.scanners.create(ScannerSpec(name="Line 2", constants=constants)).id
    spec = ScanSpec(scanner_id=scanner, data=DataKind.LINE_INTEGRALS, angles_deg="0:18")

    def upload(make):
        make(tmp_path / "upload", canaries)
        return store.scans.accept(spec, store.files.receive([(tmp_path / "upload").read_bytes()], max_bytes=2**24))

    scans = {make: (upload(make), upload(good)) for make in POINTING}
    states = [reader.run_next() for _ in range(2 * len(POINTING))]
    assert states[1::2] == [JobState.SUCCEEDED] * len(POINTING), "the good ones between"
    for make, (pointing, _) in scans.items():
        scan = store.scans.get(pointing.id)
        assert scan.state is ScanState.REFUSED, make.__name__
        assert str(CANARY) not in scan.reason, make.__name__
    assert CANARY_BYTES in everything_in(canaries)
    assert CANARY_BYTES not in everything_in(store.files.folder)
    assert str(CANARY) not in "".join(capfd.readouterr())
