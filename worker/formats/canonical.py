"""The one form every readable file is brought into."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from worker.formats.errors import UnreadableScan

# Angles closer than this are the same direction: a millionth of a degree, in radians.
SAME_DIRECTION_RAD = np.deg2rad(1e-6)


@dataclass(frozen=True, eq=False)
class CanonicalScan:
    """A scan that was checked when it was made.

    Attributes
    ----------
    projections : (views, rows, detector) float32
        Counts or line integrals, as `counts` says.
    angles_rad : (views,) float64
        Each view's own angle. The same direction may come again in a later turn, never in two successive views.
    counts : bool
        Whether the projections are detector counts; then there is at least one flat field.
    flats, darks : (n, rows, detector) float32 or None
        Counts without an object in the beam, and without a beam. Never beside line integrals.
    detector_pitch_mm, row_pitch_mm : float or None
        What the file says of the distance between cells and between rows.
    format : str
        What the file turned out to be.
    remarks : tuple of str
        What was done to the data on reading, one sentence each.
    rows_missing : bool
        Whether views may lack rows at the top or the bottom: NaN in every cell.

    Raises
    ------
    UnreadableScan
        When the parts do not agree with each other.
    """

    projections: NDArray[np.float32]
    angles_rad: NDArray[np.float64]
    counts: bool
    flats: NDArray[np.float32] | None
    darks: NDArray[np.float32] | None
    detector_pitch_mm: float | None
    row_pitch_mm: float | None
    format: str
    remarks: tuple[str, ...]
    rows_missing: bool = False

    def __post_init__(self) -> None:
        check_scan(self)


def check_scan(scan: CanonicalScan) -> None:
    """Refuse a scan whose parts do not agree, with one sentence that names the first thing wrong."""
    _check_shapes(scan)
    _check_angles(scan.angles_rad)
    _check_kind(scan)
    _check_views(scan)
    for name, fields in (("flat", scan.flats), ("dark", scan.darks)):
        if fields is not None:
            _check_finite(name, fields)


def _check_shapes(scan: CanonicalScan) -> None:
    if scan.projections.ndim != 3 or 0 in scan.projections.shape:
        raise UnreadableScan(
            "wrong-shape", f"projections must be (views, rows, detector), not of shape {scan.projections.shape}"
        )
    views, *frame = scan.projections.shape
    if views < 3:
        raise UnreadableScan("wrong-shape", f"a scan needs at least 3 views and this one has {views}")
    if scan.angles_rad.shape != (views,):
        raise UnreadableScan(
            "angles-mismatch", f"there are {scan.angles_rad.size} angles for {views} views; each view needs its own"
        )
    for name, fields in (("flat", scan.flats), ("dark", scan.darks)):
        if fields is not None and (fields.ndim != 3 or not len(fields) or list(fields.shape[1:]) != frame):
            raise UnreadableScan(
                "wrong-shape",
                f"the {name} fields have the shape {fields.shape} and the views (rows, detector) = {tuple(frame)}; "
                "both need the same rows and cells",
            )


def _check_angles(angles_rad: NDArray[np.float64]) -> None:
    if not np.isfinite(angles_rad).all():
        view = int(np.argmin(np.isfinite(angles_rad)))
        raise UnreadableScan("not-finite", f"the angle of view {view} is {angles_rad[view]}; it must be a number")
    steps = np.diff(angles_rad)
    standing = np.abs(np.remainder(steps + np.pi, 2 * np.pi) - np.pi) < SAME_DIRECTION_RAD
    if standing.any():
        view = int(np.argmax(standing))
        raise UnreadableScan(
            "angles-repeated",
            f"views {view} and {view + 1} have the same direction ({np.rad2deg(angles_rad[view]):g} degrees); "
            "the object must turn between two views",
        )


def _check_kind(scan: CanonicalScan) -> None:
    if scan.counts and scan.flats is None:
        raise UnreadableScan(
            "flats-missing",
            "counts need at least one flat field: frames with image_key 1 in NXtomo, exchange/data_white in Data "
            "Exchange, an array named flats in NPZ, MAT or HDF5, files named flat* in a ZIP; or declare line integrals",
        )
    if not scan.counts and (scan.flats is not None or scan.darks is not None):
        raise UnreadableScan(
            "contradiction",
            "the data were declared line integrals but the file carries flat or dark fields, as counts do; "
            "declare counts, or upload the line integrals without those fields",
        )


def _check_views(scan: CanonicalScan) -> None:
    for view, frame in enumerate(scan.projections):
        missing = np.isnan(frame).all(axis=1)
        if missing.any():
            _check_missing(view, missing, allowed=scan.rows_missing)
        _check_frame("view", view, np.where(missing[:, np.newaxis], np.float32(0.0), frame) if missing.any() else frame)


def _check_missing(view: int, missing: NDArray[np.bool_], *, allowed: bool) -> None:
    there = np.flatnonzero(~missing)
    if not there.size:
        raise UnreadableScan("not-finite", f"view {view} is NaN throughout; leave it out, with its angle")
    if not allowed:
        raise UnreadableScan(
            "not-finite",
            f"view {view}, row {int(missing.argmax())} is NaN in every cell; where views lost rows, ask for align_rows "
            "(--align-rows), which lays them over one another",
        )
    between = missing[there[0] : there[-1]]
    if between.any():
        raise UnreadableScan(
            "rows-missing",
            f"view {view} lacks row {int(there[0] + between.argmax())} between others; only rows at the top or the "
            "bottom can be missing",
        )


def _check_finite(name: str, stack: NDArray[np.float32]) -> None:
    for index, frame in enumerate(stack):
        _check_frame(name, index, frame)


def _check_frame(name: str, index: int, frame: NDArray[np.float32]) -> None:
    finite = np.isfinite(frame)
    if not finite.all():
        row, cell = (int(i) for i in np.unravel_index(np.argmin(finite), frame.shape))
        raise UnreadableScan(
            "not-finite",
            f"{name} {index}, row {row}, cell {cell} is {frame[row, cell]}; every value must be a finite number "
            "that fits into 32-bit floating point",
        )
