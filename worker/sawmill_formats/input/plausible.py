"""Plausible numbers in a scan: angles, counts and line integrals in the ranges that measurements have."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sawmill_formats.errors import UnreadableScan
from sawmill_formats.input.contents import RADIANS
from sawmill_vocabulary.messages import Reason
from sawmill_vocabulary.reading_messages import ReadingMessage

# 2 777 turns. At this angle double precision still tells directions 1e-10 degrees apart; no scan turns so long.
LARGEST_ANGLE_DEG = 1e6
# A detector measures less than `LARGEST_LOGARITHM`. But files give line integrals in
# units of their own, as the published log's 160 (mm of wood); this is a metre of wood in micrometres.
LARGEST_LINE_INTEGRAL = 1e6
# Largest logarithm: a transmission of exp(-50) is one quantum of 5e21.
LARGEST_LOGARITHM = 50.0
# Mean flat fields: from transmissions, whose flats are 1 or less, to the sum of hundreds of 32-bit images.
LEAST_FLAT, LARGEST_FLAT = 1e-6, 1e12
# Where a dark signal was subtracted, noise leaves counts below 0; beyond this share of the flats they are no noise.
# Counts a million times above the flats are as far off as a transmission that is cut off (`LEAST_TRANSMISSION`, as
# `MOST_DEAD`).
MOST_BELOW_ZERO, MOST_ABOVE_FLAT = 0.05, 1e6
# Share of the samples, as of dead cells (`tomography.preparing.line_integrals.MOST_DEAD`): a few faulty cells are no
# fault of the scan, and are bridged.
MOST_WILD = 0.2
# Share of the detector's cells, on either side, in which there is air in every view.
AIR_SHARE = 0.02
# Line integrals rise behind the log, counts and transmissions fall. A log leaves the mean of all samples, relative to
# their range, several times as far from the air's level: 0.09 for a log of a tenth of the detector
# (tests/formats/input/test_averaged.py).
LEAST_FALL = 0.05
# Where values fall behind the log, none are far above the air's level.
MOST_ABOVE_AIR = 0.25
# Fewest cells of a profile, and the most views and rows of a block that are taken for it.
LEAST_CELLS, MOST_VIEWS, MOST_ROWS = 64, 64, 8
# Fewer angles may be any.
LEAST_ANGLES = 16


def check_angles(angles_deg: NDArray[np.float64]) -> None:
    """Refuse angles that are no numbers, or are beyond any turning: `not-finite` or `out-of-range`."""
    usable = np.abs(angles_deg) <= LARGEST_ANGLE_DEG
    if usable.all():
        return
    view = int(np.argmin(usable))
    raise UnreadableScan(
        "out-of-range" if np.isfinite(angles_deg[view]) else "not-finite",
        f"the angle of view {view} is {angles_deg[view]:g} degrees; it must be a number between "
        f"{-LARGEST_ANGLE_DEG:.0f} and {LARGEST_ANGLE_DEG:.0f}",
    )


def closes(views: int, step: float, period: float) -> bool:
    """Return whether equidistant views make whole periods, within half a step, with or without the closing view."""
    reached = (views + 0.5) * abs(step)
    return reached >= period and reached % period <= 2.0 * abs(step)


def unit_of_angles_asked(angles_deg: NDArray[np.float64], unit: str | None) -> tuple[Reason, ...]:
    """Return the question whether angles are in another unit, where they are half turns in that unit alone."""
    views = angles_deg.size
    if views < LEAST_ANGLES or not (np.abs(angles_deg) <= LARGEST_ANGLE_DEG).all():
        return ()
    ends = np.array([angles_deg.min(), angles_deg.max()])
    step_deg = float(np.ptp(ends)) / (views - 1)
    # From five sixths of a half turn in turns to two turns in radians; no scan for tomography spans as few degrees.
    if 0.4 <= np.ptp(ends) <= 4.0 * np.pi + step_deg:
        return (ReadingMessage.RADIANS_ASKED(least_deg=float(ends[0]), most_deg=float(ends[1])),)
    ends = np.deg2rad(ends)
    is_closed = np.ptp(ends) > 8.0 * np.pi and closes(views, np.deg2rad(step_deg), 180.0)
    if is_closed and (unit or "").strip().lower() in RADIANS:
        return (ReadingMessage.DEGREES_ASKED(least_rad=float(ends[0]), most_rad=float(ends[1])),)
    return ()


def profile_of(rays: NDArray[np.float32]) -> NDArray[np.float64]:
    """Return the median of rays (rays, detector) along the detector, in which NaN is missing."""
    return np.nanmedian(rays[:, np.isfinite(rays).any(axis=0)], axis=0).astype(np.float64)


def level_of_air(profile: NDArray[np.float64]) -> float:
    """Return the level at the detector's ends."""
    air = max(1, round(AIR_SHARE * profile.size))
    return min(float(np.median(profile[:air])), float(np.median(profile[-air:])))


def falls(profile: NDArray[np.float64]) -> bool:
    """Return whether the values fall behind the log."""
    return bool(level_of_air(profile) - profile.mean() > LEAST_FALL * np.ptp(profile))


@dataclass(frozen=True)
class SampleRange:
    """Range of the samples of a scan."""

    low: float  # the least and the largest value
    high: float
    unit: str  # unit of the values, and the origin of the range, for the refusal
    reason: str
    most_outside: float = 0.0  # the share of samples that may lie outside; 0 where each of them is refused


LINE_INTEGRALS = SampleRange(
    -LARGEST_LINE_INTEGRAL, LARGEST_LINE_INTEGRAL, "", "no line integral is larger, in whichever unit"
)


def check_finite(name: str, index: int, image: NDArray[np.float32], first_row: int = 0) -> None:
    """Refuse an image (rows, cells) in which a value is NaN or infinite: `not-finite`, with its place."""
    finite = np.isfinite(image)
    if not finite.all():
        row, cell = (int(i) for i in np.unravel_index(np.argmin(finite), image.shape))
        raise UnreadableScan(
            "not-finite",
            f"{name} {index}, row {first_row + row}, cell {cell} is {image[row, cell]}; every value must be a finite "
            "number that fits into 32-bit floating point",
        )


def range_of_counts(flats: NDArray[np.float32], darks: NDArray[np.float32] | None) -> SampleRange:
    """Return the range of counts with these fields (fields, rows, detector), checked: `out-of-range`."""
    level = float(np.median(flats.mean(axis=0, dtype=np.float64)))
    if not LEAST_FLAT <= level <= LARGEST_FLAT:
        highest = float(flats.max())
        raise UnreadableScan(
            "out-of-range",
            f"the median of the flat fields is {level:g} counts (the largest is {highest:g}); it must be between "
            f"{LEAST_FLAT:g} and {LARGEST_FLAT:g}: take the flat fields with the beam on",
        )
    counts = SampleRange(
        -MOST_BELOW_ZERO * level,
        MOST_ABOVE_FLAT * level,
        " counts",
        f"flat fields of {level:g} counts leave no others",
        MOST_WILD,
    )
    if darks is not None:
        SamplesOutside(counts, darks.size, "dark").add(darks)
    return counts


class SamplesOutside:
    """The samples of a scan that are outside of their range, counted as they are read."""

    def __init__(self, allowed: SampleRange, samples: int, name: str = "view") -> None:
        self._allowed, self._most, self._samples = allowed, allowed.most_outside * samples, samples
        self._name, self._outside, self._first = name, 0, ""
        self.largest, self._profile = -np.inf, np.zeros(1)

    def add(self, images: NDArray[np.float32], first: int = 0, first_row: int = 0) -> None:
        """Count samples out of range in images (images, rows, cells), without NaN: `out-of-range` for too many."""
        for index, image in enumerate(images, first):
            # Two passes that allocate nothing; in a view that lacks rows both are NaN.
            low, high = float(image.min()), float(image.max())
            if not (low >= self._allowed.low and high <= self._allowed.high):
                high = float(np.fmax.reduce(image, axis=None))
                self._count(image, index, first_row)
            self.largest = max(self.largest, high)
        views, rows, cells = images.shape
        if self._allowed is LINE_INTEGRALS and cells >= LEAST_CELLS:
            some = images[:: -(-views // MOST_VIEWS), :: -(-rows // MOST_ROWS)]
            profiles = [profile_of(some[:, row]) for row in range(some.shape[1]) if np.isfinite(some[:, row]).any()]
            self._profile = max(self._profile, *profiles, key=np.ptp)

    def _count(self, image: NDArray[np.float32], index: int, first_row: int) -> None:
        outside = (image < self._allowed.low) | (image > self._allowed.high)
        if not outside.any():
            return
        if not self._outside:
            row, cell = (int(i) for i in np.unravel_index(np.argmax(outside), image.shape))
            place = f"{self._name} {index}, row {first_row + row}, cell {cell}"
            self._first = f"{place} is {image[row, cell]:g}{self._allowed.unit}"
        self._outside += int(np.count_nonzero(outside))
        if self._outside > self._most:
            raise self._refusal()

    def _refusal(self) -> UnreadableScan:
        allowed = self._allowed
        between = f"between {allowed.low:g} and {allowed.high:g}{allowed.unit} ({allowed.reason})"
        if not allowed.most_outside:
            return UnreadableScan("out-of-range", f"{self._first}; it must lie {between}")
        return UnreadableScan(
            "out-of-range",
            f"{self._first} and at least {self._outside} of {self._samples} samples do not lie {between}; at most "
            f"{allowed.most_outside:.0%} may, as cells at fault do: check their type, and what was taken off them",
        )

    def check_signal(self) -> None:
        """Refuse counts that are nowhere above 0: `no-signal`."""
        if self.largest <= 0.0:
            raise UnreadableScan(
                "no-signal",
                f"all {self._samples} counts of the scan are 0 or less (the largest is {self.largest:g}); they must be "
                "above 0 where the beam reaches the detector",
            )

    def check_rise(self) -> None:
        """Refuse line integrals that fall behind the log, in the row in which they vary most: `contradiction`."""
        profile, level = self._profile, level_of_air(self._profile)
        allowed = MOST_ABOVE_AIR * np.ptp(profile)
        near_zero, near_one_or_counts = abs(level) < allowed, 0.5 < level < 1.5 or level > LARGEST_LOGARITHM
        if not (falls(profile) and profile.max() - level <= allowed and (near_zero or near_one_or_counts)):
            return
        take = "take -ln of transmissions, or declare counts and give their flat fields"
        looks = "their sign is wrong: multiply them by -1" if near_zero else f"these look like transmissions: {take}"
        raise UnreadableScan(
            "contradiction",
            f"the values fall from {level:.3g} at the detector's ends to {profile.min():.3g} behind the log, "
            f"and line integrals rise; {looks}",
        )
