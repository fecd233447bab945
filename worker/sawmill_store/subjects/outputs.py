"""Output of a job in its folder, checked before anybody else reads the output.

The process that wrote the output has read a stranger's upload and may be compromised: the job's supervisor inspects
names alone, and another confined process reads the file. No science is imported here.
"""
# ruff: noqa: PLC0415 - a worker at rest does not hold h5py

import os
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from itertools import islice
from pathlib import Path
from types import MappingProxyType
from typing import Any

from sawmill_contracts import kinds
from sawmill_contracts.calibrations import Provenance
from sawmill_contracts.handed_over import HandedOver
from sawmill_contracts.inspections import PICTURE_PX, InspectionResult, ScanPicture
from sawmill_contracts.reconstructions import Reconstruction, ReconstructionResult
from sawmill_contracts.row_ranges import parse_rows
from sawmill_contracts.scans import ScanReading, ScanShape
from sawmill_formats.errors import NotAsWritten, damage_reported, quoted
from sawmill_platform.contracts.base import Contract
from sawmill_platform.contracts.jobs import JobKind
from sawmill_platform.errors import DamagedResult, InvalidOutput
from sawmill_platform.files.verified_results import regular_status


def output_file(kind: JobKind, folder: Path) -> Path | None:
    """Return the file that a job of this kind left, unopened; None: jobs of this kind leave none.

    Raises
    ------
    InvalidOutput
        The folder has other files, or a file that is more than a name in it; one sentence gives the reason.
    """
    name, _ = _FILES.get(kind, (None, None))
    with os.scandir(folder) as entries:
        found = [entry.name for entry in islice(entries, 2)]
    if kind == kinds.INSPECT and found and found[0] in set(ScanPicture):  # a picture, or nothing
        name = found[0]
    if found != ([] if name is None else [name]):
        raise InvalidOutput(f"the job left the files {quoted(str(found))}, and {name or 'none'} is due")
    if name is None:
        return None
    with _as_output(name):
        if regular_status(folder / name).st_nlink > 1:
            raise NotAsWritten("it has a second name elsewhere")
    return folder / name


def check_file(kind: JobKind, given: HandedOver, result: Contract, path: Path) -> None:
    """Refuse a file that does not fit the job that wrote it; a reader in C may crash or loop.

    Parameters
    ----------
    kind, given, result
        Kind of the job, input of the job, and result of the job.

    Raises
    ------
    InvalidOutput
        The file is wrong; one sentence gives the reason.
    """
    from sawmill_formats.hdf5_walk import walk

    _, check = _FILES.get(kind, ("", _check_picture))
    with _as_output(path.name):
        walk(path, follow_links=False)  # through parts that the check passes over, and other readers meet
        check(path, given, result)


@contextmanager
def _as_output(name: str) -> Iterator[None]:
    """Turn the damage of a file that a job left into `InvalidOutput`."""
    try:
        with damage_reported(name):
            yield
    except DamagedResult as error:
        raise InvalidOutput(f"the job left a {name} that jobs of its kind do not write: {error.reason}") from error
    except PermissionError as error:
        raise InvalidOutput("the job left files that nobody may read") from error


def _check_picture(path: Path, _: HandedOver, __: InspectionResult) -> None:
    """Check the length: any bytes of that length are a picture."""
    if path.stat().st_size != PICTURE_PX**2:
        raise NotAsWritten(f"it has {path.stat().st_size} bytes, not {PICTURE_PX**2}")


def _check_scan(path: Path, given: HandedOver, reading: ScanReading) -> None:
    from sawmill_formats.output.scan_reader import check_scan

    cells = None if given.scanner is None else given.scanner.constants.num_detector_pixels
    if reading.shape.detector != cells:
        raise NotAsWritten(f"the answer is of {reading.shape.detector} detector cells, and the scanner has {cells}")
    check_scan(path, reading.shape.lengths)


def _check_calibration(path: Path, given: HandedOver, provenance: Provenance) -> None:
    from sawmill_formats.output.calibration_file import check_calibration

    shape, _ = _scan_of(given)
    if provenance.views > shape.views:
        raise NotAsWritten(f"the answer is of {provenance.views} views, and the scan has {shape.views}")
    check_calibration(path, (provenance.views, shape.detector))


def _check_volume(path: Path, given: HandedOver, result: ReconstructionResult) -> None:
    from sawmill_formats.output.volume_reader import check_volume

    options = Reconstruction.model_validate_json(given.asked_json or "").options
    shape, usable = _scan_of(given)
    rows = usable if options.rows is None else parse_rows(options.rows)
    due = (len(range(shape.rows)[rows]), options.size, options.size)
    if result.shape != due:
        raise NotAsWritten(f"the answer is of the shape {result.shape}, and {due} was asked for")
    check_volume(path, due)


def _scan_of(given: HandedOver) -> tuple[ScanShape, slice]:
    """Return the shape of the scan, and the rows that enough views have."""
    scan = given.scan
    assert scan is not None  # noqa: S101 - of a kind that refers to one
    assert scan.shape is not None  # noqa: S101 - a job without it had failed
    return scan.shape, slice(*(scan.usable_rows or (0, scan.shape.rows)))


# The one file that a job must write, and its check; jobs of the other kinds write none.
_FILES: Mapping[JobKind, tuple[str, Callable[[Path, HandedOver, Any], None]]] = MappingProxyType(
    {
        kinds.INGEST: ("scan.h5", _check_scan),
        kinds.CALIBRATE: ("result.h5", _check_calibration),
        kinds.RECONSTRUCT: ("volume.h5", _check_volume),
    }
)
