"""The one form into which every readable file is brought, also one of the mean over detector rows."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Self

import numpy as np
from numpy.typing import NDArray

from sawmill_formats.errors import UnreadableScan
from sawmill_formats.input import plausible
from sawmill_formats.input.arrays import check_fields
from sawmill_formats.input.contents import Projections
from sawmill_vocabulary import DetectorModule
from sawmill_vocabulary.messages import Reason, selected
from sawmill_vocabulary.reading_messages import ReadingMessage

# Share of a view's rays. Masked rays are interpolated, and a log's shadow is a third of the detector or more.
MOST_MASKED = 0.2
# Least line integral of air. The beam behind air is the flat field's but for the tube's drift: e times as many counts
# are impossible.
LEAST_AIR = -1.0


@dataclass(frozen=True, eq=False)
class AveragedRows:
    """Origin of a scan's one row as a mean over rows."""

    rows: int  # the number of detector rows whose line integrals were averaged
    # (views, detector) float32, or None: the standard deviation of each mean; infinite where a ray is masked
    deviations: NDArray[np.float32] | None

    @classmethod
    def of(cls, rows: int, shape: tuple[int, ...], deviations: NDArray[np.float32] | None) -> Self:
        """Check the shapes of the projections as they were sent, and of their deviations: `wrong-shape`."""
        if len(shape) == 3 and shape[1] != 1:
            raise UnreadableScan(
                "wrong-shape",
                f"averaged_rows says that {rows} rows were averaged, so projections are (views, detector), and these "
                f"are (views, rows, detector) = {shape}: send their mean over the rows, or leave averaged_rows out",
            )
        if deviations is None:
            return cls(rows, None)
        if deviations.shape != shape:
            raise UnreadableScan(
                "wrong-shape",
                f"deviations have the shape {deviations.shape} and the line integrals {shape}; there must be one of "
                "each line integral",
            )
        return cls(rows, deviations.reshape(shape[0], shape[-1]))

    def mask(self, samples: NDArray[np.float32], first_view: int) -> None:
        """Make the masked rays among samples (views, 1, detector) NaN, in place, and check the samples."""
        if self.deviations is not None:
            deviations = self.deviations[first_view : first_view + len(samples)]
            _check_deviations(deviations, samples[:, 0], first_view)
            samples[:, 0][np.isinf(deviations)] = np.nan
        masked = np.isnan(samples).sum(axis=(1, 2))
        view = int(np.argmax(masked))
        if masked[view] > MOST_MASKED * samples.shape[2]:
            raise UnreadableScan(
                "not-finite",
                f"{masked[view]} of {samples.shape[2]} rays of view {first_view + view} are masked, as NaN or by an "
                f"infinite deviation; at most {MOST_MASKED:.0%} may be: leave the view out, with its angle",
            )
        for view, image in enumerate(samples, first_view):
            plausible.check_finite("view", view, np.where(np.isnan(image), np.float32(0.0), image))
        _check_logarithms(samples[:, 0])


def _check_deviations(deviations: NDArray[np.float32], rays: NDArray[np.float32], first_view: int) -> None:
    # A number that only means "not known" would be used as a weight next to real deviations.
    largest = float(np.max(np.abs(rays), where=np.isfinite(rays), initial=0.0))
    wrong = ~((deviations > 0.0) & ((deviations <= largest) | np.isinf(deviations))) & ~np.isnan(rays)
    if wrong.any():
        view, cell = (int(i) for i in np.unravel_index(np.argmax(wrong), wrong.shape))
        raise UnreadableScan(
            "out-of-range",
            f"the standard deviation of view {first_view + view}, cell {cell} is {deviations[view, cell]:g}; it must "
            f"be above 0, not above the largest line integral ({largest:.3g}), and infinite where the ray is masked",
        )


def _check_logarithms(rays: NDArray[np.float32]) -> None:
    """Refuse values too large for a logarithm, that are no logarithm of counts over flats, or fall behind the log."""
    take = (
        "take -ln((counts - dark) / (flat - dark)) of every row first and average that over the rows, because -ln of a "
        "mean is not the mean of -ln"
    )
    largest = float(np.nanmax(rays))
    if largest > plausible.LARGEST_LOGARITHM:
        raise UnreadableScan(
            "contradiction",
            f"the values reach {largest:.3g} and no -ln of a transmission is above {plausible.LARGEST_LOGARITHM:.0f}, "
            f"so they are counts or in another unit: {take}",
        )
    profile = plausible.profile_of(rays)
    level = plausible.level_of_air(profile)
    if plausible.falls(profile):
        raise UnreadableScan(
            "contradiction",
            f"the values fall from {level:.3g} at the detector's ends to {profile.min():.3g} behind the log, as counts "
            f"and transmissions do, and line integrals rise: {take}",
        )
    if level < LEAST_AIR:
        raise UnreadableScan(
            "contradiction",
            f"the values are {level:.3g} at the detector's ends, where air has nearly 0, as where counts were not "
            f"divided by the flat field: {take}",
        )


# Angles closer than this are the same direction: a millionth of a degree, in radians.
SAME_DIRECTION_RAD = np.deg2rad(1e-6)


@dataclass(frozen=True, eq=False)
class CanonicalScan:
    """A scan in an open file: checked when it was made, its projections as they are read.

    Raises
    ------
    UnreadableScan
        When the parts do not agree with each other.
    """

    projections: Projections  # counts or line integrals, as `counts` says
    # (views,): each view's own angle. The same direction may come again in a later turn, never in two successive views.
    angles_rad: NDArray[np.float64]
    counts: bool  # whether the projections are detector counts; then there is at least one flat field
    flats: NDArray[np.float32] | None  # (n, rows, detector): without an object in the beam; never with line integrals
    darks: NDArray[np.float32] | None  # (n, rows, detector): without a beam
    detector_pitch_mm: float | None
    row_pitch_mm: float | None
    format: str
    remarks: tuple[Reason, ...]  # changes that were made to the data on reading, and what the file lacks
    rows_missing: bool = False  # whether views may lack rows at the top or the bottom: NaN in every cell
    unused: str | None = None  # values that could be pitch or distance, where the file does not state what they are
    others: tuple[Path, ...] = ()  # further files that were read
    detector_modules: tuple[DetectorModule, ...] = ()  # modules of the detector after the first
    detector_arc_radius_mm: float | None = None  # radius of the arc on which the cells lie
    averaged: AveragedRows | None = None  # for a scan whose one row is a mean over rows: masked rays are NaN
    turns: bool = True  # False: the views are passages through a fixed pair, whose angles say nothing

    def __post_init__(self) -> None:
        check_scan(self)

    @cached_property
    def sample_range(self) -> plausible.SampleRange:
        """Range of the samples: of counts, with the flat fields, else of line integrals."""
        return plausible.LINE_INTEGRALS if self.flats is None else plausible.range_of_counts(self.flats, self.darks)

    @property
    def shape(self) -> tuple[int, int, int]:
        """Shape (views, rows, detector)."""
        views, *rows, cells = self.projections.shape
        return views, rows[0] if rows else 1, cells

    def block_shape(self, window_bytes: int) -> tuple[int, int]:
        """Return the numbers of views and rows of a block that fills a window of memory.

        All views of some rows where the file can be read so, else whole views, else a few of both: in whole pieces as
        the file stores them, and never less than one.
        """
        views, rows, cells = self.shape
        piece_views, piece_rows = (
            min(n, most) for n, most in zip(self.projections.together, (views, rows), strict=True)
        )
        fitting = max(1, window_bytes // (4 * cells))
        if views * piece_rows <= fitting:
            return views, min(rows, _whole(fitting // views, piece_rows))
        if piece_views * rows <= fitting:
            return min(views, _whole(fitting // rows, piece_views)), rows
        return min(views, max(piece_views, _whole(fitting // piece_rows, piece_views))), piece_rows

    def blocks(self, window_bytes: int) -> Iterator["Block"]:
        """Yield every sample once, checked, in blocks of `block_shape`, rows before views.

        No block is kept here after it is handed over, so there is only one in memory if its user keeps none either.

        Raises
        ------
        UnreadableScan
            Where the next block cannot be read or holds what no scan can, and after the last one where rows are missing
            that cannot be.
        """
        views, rows, _ = self.shape
        step_views, step_rows = self.block_shape(window_bytes)
        missing = np.zeros((views, rows), bool)
        outside = plausible.SamplesOutside(self.sample_range, math.prod(self.shape))
        for first_view in range(0, views, step_views):
            for first_row in range(0, rows, step_rows):
                at = slice(first_view, min(first_view + step_views, views))
                yield self._block(at, slice(first_row, min(first_row + step_rows, rows)), missing, outside)
        if self.counts:
            outside.check_signal()
        else:
            outside.check_rise()
        for view in np.flatnonzero(missing.any(axis=1)):
            there = np.flatnonzero(~missing[view])
            if not there.size:
                raise _lacking_throughout(int(view))
            between = missing[view][there[0] : there[-1]]
            if between.any():
                raise UnreadableScan(
                    "rows-missing",
                    f"view {view} lacks row {int(there[0] + between.argmax())} between others; only rows at the top "
                    "or the bottom can be missing",
                )

    def _block(
        self, views: slice, rows: slice, missing: NDArray[np.bool_], outside: plausible.SamplesOutside
    ) -> "Block":
        samples = self.projections.read(views, rows)
        if self.counts and self.rows_missing:
            samples[~samples.any(axis=2)] = np.nan
        if self.averaged is None:
            missing[views, rows] = self._missing_rows(samples, views.start, rows.start)
        else:
            self.averaged.mask(samples, views.start)
        outside.add(samples, views.start, rows.start)
        return Block(views, rows, samples)

    def _missing_rows(self, samples: NDArray[np.float32], first_view: int, first_row: int) -> NDArray[np.bool_]:
        """Find the rows (views, rows) of a block that are NaN in every cell, all else being finite."""
        missing = np.zeros(samples.shape[:2], bool)
        for view, image in enumerate(samples):
            unusable = ~np.isfinite(image).all(axis=1)
            if not unusable.any():
                continue
            missing[view, unusable] = np.isnan(image[unusable]).all(axis=1)
            if missing[view].any() and not self.rows_missing:
                if len(image) == self.shape[1] and missing[view].all():
                    raise _lacking_throughout(first_view + view)
                raise UnreadableScan(
                    "not-finite",
                    f"view {first_view + view}, row {first_row + int(missing[view].argmax())} is NaN in every cell; "
                    "where views lack rows, ask for align_rows (--align-rows), which aligns them along the log",
                )
            present = np.where(missing[view][:, np.newaxis], np.float32(0.0), image)
            plausible.check_finite("view", first_view + view, present, first_row)
        return missing


@dataclass(frozen=True, eq=False)
class Block:
    """Block of a scan: some views and rows, and their samples (views, rows, detector) float32."""

    views: slice
    rows: slice
    samples: NDArray[np.float32]


def _whole(fitting: int, piece: int) -> int:
    return fitting // piece * piece


def check_scan(scan: CanonicalScan) -> None:
    """Refuse a scan whose parts do not agree, with one sentence that names the first thing wrong."""
    _check_shapes(scan)
    plausible.check_angles(np.rad2deg(scan.angles_rad))
    standing = scan.turns & (
        np.abs(np.remainder(np.diff(scan.angles_rad) + np.pi, 2 * np.pi) - np.pi) < SAME_DIRECTION_RAD
    )
    if standing.any():
        view = int(np.argmax(standing))
        raise UnreadableScan(
            "angles-repeated",
            f"views {view} and {view + 1} have the same direction ({np.rad2deg(scan.angles_rad[view]):g} degrees); "
            "the object must turn between two views",
        )
    if scan.counts and scan.flats is None:
        left_out = next(selected(scan.remarks, ReadingMessage.IMAGES_LEFT_OUT), None)
        raise UnreadableScan(
            "flats-missing",
            "counts need at least one flat field: images with image_key 1 in NXtomo, exchange/data_white in Data "
            "Exchange, an array named flats in NPZ, MAT or HDF5, files named flat* in a ZIP; on the command line also "
            "in a file of their own (--flats); or declare line integrals" + (f". {left_out}" if left_out else ""),
        )
    if not scan.counts and (scan.flats is not None or scan.darks is not None):
        raise UnreadableScan(
            "contradiction",
            "the data were declared line integrals but the file carries flat or dark fields, as counts do; "
            "declare counts, or upload the line integrals without those fields",
        )
    for name, fields in (("flat", scan.flats), ("dark", scan.darks)):
        if fields is not None:
            for index, image in enumerate(fields):
                plausible.check_finite(name, index, image)
    if scan.counts:
        _ = scan.sample_range  # which the fields themselves must satisfy


def _check_shapes(scan: CanonicalScan) -> None:
    if 0 in scan.shape:
        none = "" if scan.shape[0] else ": none of its images is a view (in NXtomo those of image_key 0)"
        raise UnreadableScan(
            "wrong-shape",
            f"projections must be (views, rows, detector) and at least 1 of each, not of shape {scan.shape}{none}",
        )
    views, *of_view = scan.shape
    if views < 3 and scan.turns:
        raise UnreadableScan("wrong-shape", f"a scan needs at least 3 views and this one has {views}")
    if scan.shape[2] < 2:
        raise UnreadableScan("wrong-shape", f"a view needs at least 2 cells and these have {scan.shape[2]}")
    if scan.angles_rad.shape != (views,):
        raise UnreadableScan(
            "angles-mismatch", f"there are {scan.angles_rad.size} angles for {views} views; each view needs its own"
        )
    for name, fields in (("flat", scan.flats), ("dark", scan.darks)):
        if fields is not None:
            check_fields(name, fields.shape, of_view)


def _lacking_throughout(view: int) -> UnreadableScan:
    return UnreadableScan(
        "not-finite", f"view {view} has no signal: NaN, or for counts 0, in every cell; leave it out, with its angle"
    )
