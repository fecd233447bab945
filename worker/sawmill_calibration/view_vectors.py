"""Files of geometry: a list of vectors for each view, as our JSON or as rows of ASTRA's `fanflat_vec` (.npy)."""

import json
from dataclasses import dataclass, replace
from io import BytesIO
from pathlib import Path
from typing import Any, Self

import numpy as np

from sawmill_calibration.failures import refused
from sawmill_calibration.known_geometry import GivenGeometry, KnownGeometry
from sawmill_calibration.scans.scan_rows import ScanRows
from sawmill_contracts.geometry import ScannerConstants
from sawmill_formats.errors import UnreadableScan, library_errors_translated
from sawmill_formats.input.npy import read_header
from sawmill_platform.contracts.attempts import JobFailure
from sawmill_tomography.geometry.detector_shape import FlatDetector
from sawmill_tomography.geometry.geometry import SAME_MM, FanViews, turning
from sawmill_vocabulary import Handedness, Rotation
from sawmill_vocabulary.scattered_radiation import NOTHING_FOUND, BeamCorrection


@dataclass(frozen=True, eq=False)
class ImportedGeometry:
    """A geometry given by vectors for each view of a scan, without error bars."""

    scanner: ScannerConstants
    views: FanViews
    theta: None = None
    rotation: Rotation = Rotation.AS_GIVEN
    handedness: Handedness = Handedness.AS_DRAWN
    beam: BeamCorrection = NOTHING_FOUND

    @classmethod
    def of(cls, views: FanViews, scan: ScanRows) -> tuple[ScanRows, Self]:
        """Return the scan with the angles of these views, and the geometry of the views that are used, or refuse it."""
        used = np.ones(scan.angles_rad.size, bool) if scan.used_views is None else scan.used_views
        wanted = (used.size, scan.scanner.num_detector_pixels)
        if views.sinogram_shape != wanted:
            of = f"(views, cells) = {views.sinogram_shape}"
            raise refused("contradiction", f"the geometry is of {of}, and the scan has {wanted}: give all its views")
        chosen = views.at(used)
        return replace(scan, angles_rad=chosen.angles_rad), cls(scan.scanner, chosen)

    def turned(self, scan: ScanRows) -> tuple[ScanRows, GivenGeometry]:
        """Return the scan with cells at equal distances, and the geometry as a turn; a GeometryError if it is none."""
        turn = turning(self.views)
        if turn.uneven_mm > SAME_MM:
            flat, read = FlatDetector.of(turn.borders_mm, turn.scanner), scan.read
            scan = replace(scan, read=lambda start, stop: flat.resampled(read(start, stop)))
        constants = replace(scan.scanner, **vars(turn.scanner))
        return replace(scan, scanner=constants), GivenGeometry(constants, turn.theta)


AnyGeometry = KnownGeometry | ImportedGeometry
# Larger files are no lists of vectors.
LARGEST_BYTES = 2**24
NPY = b"\x93NUMPY"
NAMES = ("source_mm", "middle_mm", "axis", "cell_borders_mm")


def read_views(path: str | Path, cells: int | None = None) -> FanViews:
    """Read a file of geometry.

    Parameters
    ----------
    path : str or Path
        JSON that `sawmill export --to vectors` wrote, or .npy with rows (views, 6) of `fanflat_vec`.
    cells : int, optional
        Number of the detector's cells, which rows of `fanflat_vec` do not state: None takes them to be of 2.

    Raises
    ------
    ValueError
        The file is no geometry.
    """
    path = Path(path)
    try:
        content = path.read_bytes()
        if content.startswith(NPY):
            return FanViews.from_astra(np.load(BytesIO(content), allow_pickle=False), cells or 2)
        held = json.loads(content)
        return FanViews.of(*(held[name] for name in NAMES))
    except (ValueError, TypeError, KeyError, EOFError, RecursionError) as error:
        forms = f"JSON with {', '.join(NAMES)}, or rows of fanflat_vec (.npy)"
        raise refused("geometry", f"{path.name} is no file of geometry, {forms}: {error}") from error


def list_of_views(path: Path) -> FanViews | None:
    """Return the geometry of a file of vectors, as `read_views`; None for any other file, or a folder."""
    if not path.is_file() or path.stat().st_size > LARGEST_BYTES:
        return None
    try:
        with library_errors_translated("NPY"), path.open("rb") as stream:
            if stream.peek(1)[:1] != b"{":
                header = read_header(stream)
                if header.shape[1:] != (6,) or header.data_bytes > LARGEST_BYTES:
                    return None
        return read_views(path)
    except (JobFailure, UnreadableScan):
        return None


def vectors_of(views: FanViews) -> dict[str, Any]:
    """Return the content of a file of geometry, JSON, which `read_views` reads."""
    return dict(zip(NAMES, (each.tolist() for each in (*views.vectors(), views.borders_mm)), strict=True))
