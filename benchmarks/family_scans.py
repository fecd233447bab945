"""Scans of the study by family (families.py): exact chords, with effects of one family in each scan.

Nothing here is from the calibration's forward model: chords are those of `tests/support/exact_chords.py`, and each
effect is written as the physics has it (two energies, a Gaussian halo, bent planks).
"""

import math
import sys
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from scipy.ndimage import gaussian_filter1d

from sawmill_tomography.calibration.task import CalibrationTask
from sawmill_tomography.geometry.geometry import FloatArray
from sawmill_tomography.phantoms.built_in import L_SHAPE, RECTANGLE_WITH_HOLE
from sawmill_tomography.phantoms.phantom import Phantom
from sawmill_vocabulary import DetectorModule, Disc, Polygon, Scanner, SourceFrame

sys.path.append(str(Path(__file__).parents[1] / "tests/support"))
from exact_chords import Array, Detector, counted, scan

SOURCE_TO_COR_MM = 859.46
VIEWS, FEW_VIEWS = (12, 20, 45, 90, 180), range(8, 25)
# A bent side or a round corner is a polygon of this number of pieces.
PIECES = 6
# Joints are this number of cells from the edges of the phantom's shadow, or more.
FROM_EDGE = 20
# Sizes of effects in scans of few views, as a share of the others.
MILD = 0.4


@dataclass
class Making:
    """A scan before its counts: what the effects have changed so far.

    Attributes
    ----------
    moved_mm : (views, 2) float64
        Displacement of the phantom in the laboratory, across and along the beam.
    turned_rad : (views,) float64
    optics : list of callable
        Changes of the transmissions (views, cells), in the order in which they act.
    """

    rng: np.random.Generator
    drawing: Phantom
    frame: SourceFrame
    detector: Detector
    angles_rad: FloatArray
    photons: float
    shapes: list[Polygon | Disc]
    moved_mm: FloatArray = field(init=False)
    turned_rad: FloatArray = field(init=False)
    slope_per_mm: tuple[float, float] = (0.0, 0.0)
    energies: tuple[float, float] = (0.0, 0.0)
    optics: list[Callable[[Array], Array]] = field(default_factory=list)

    def __post_init__(self) -> None:
        """Let nothing move."""
        self.moved_mm, self.turned_rad = np.zeros((self.views, 2)), np.zeros(self.views)

    @property
    def views(self) -> int:
        """Number of views."""
        return len(self.angles_rad)

    @property
    def scanner(self) -> Scanner:
        """The scanner that made the scan."""
        return Scanner(SOURCE_TO_COR_MM, self.detector.cells, self.detector.pitch_mm, self.detector.modules)

    def either(self, size: float) -> float:
        """Return the size with either sign."""
        return size if self.rng.random() < 0.5 else -size

    def split(self) -> int:
        """Return a view in the middle three fifths."""
        return int(self.rng.integers(math.ceil(0.2 * self.views), math.ceil(0.8 * self.views)))

    def progress(self) -> FloatArray:
        """Return a line from -1/2 at the first view to 1/2 at the last."""
        return np.linspace(-0.5, 0.5, self.views)

    def move_phantom(self, shape: FloatArray, size_mm: float) -> None:
        """Move the phantom on the turntable, into a random direction, by `size_mm` times a shape (views,)."""
        way = self.rng.uniform(0.0, 2.0 * math.pi)
        x, y = size_mm * math.cos(way) * shape, size_mm * math.sin(way) * shape
        beta = self.angles_rad + self.frame.psi_rad
        self.moved_mm[:, 0] += np.cos(beta) * x + np.sin(beta) * y
        self.moved_mm[:, 1] += np.cos(beta) * y - np.sin(beta) * x

    def move_scanner(self, shape: FloatArray, size_mm: float) -> None:
        """Move the phantom in the laboratory, into a random direction; the geometry is the mean one."""
        way = self.rng.uniform(0.0, 2.0 * math.pi)
        self.moved_mm += size_mm * (shape - shape.mean())[:, None] * [math.cos(way), math.sin(way)]

    def task(self, seed: int) -> CalibrationTask:
        """Return the calibration of this scan, which knows the drawing, and no module of the detector."""
        weight, ratio = self.energies

        def beam(paths: Array) -> Array:
            # Two energies, whose mean attenuation on a short path is that of the drawing.
            hard = 1.0 / (1.0 - weight + weight * ratio)
            return (1.0 - weight) * np.exp(-hard * paths) + weight * np.exp(-hard * ratio * paths)

        shown = scan(
            self.shapes,
            self.detector,
            self.frame,
            self.angles_rad,
            moved_mm=self.moved_mm,
            turned_rad=self.turned_rad,
            slope_per_mm=self.slope_per_mm,
            beam=beam,
        )
        for change in self.optics:
            shown = change(shown)
        lines = counted(shown, photons=self.photons, seed=seed)
        known = replace(self.scanner, detector_modules=())
        return CalibrationTask(known, self.drawing, lines, self.angles_rad, from_counts=True)


# Beam and detector.
def _hardening(making: Making, size: float) -> None:
    making.energies = (making.rng.uniform(0.2, 0.6), 1.0 + size)


def _scatter(making: Making, size: float) -> None:
    width = math.exp(making.rng.uniform(math.log(20.0), math.log(120.0)))
    making.optics.append(lambda shown: shown + size * (1.0 - gaussian_filter1d(shown, width, axis=1, mode="nearest")))


def _blur(making: Making, size: float) -> None:
    making.optics.append(lambda shown: gaussian_filter1d(shown, size, axis=1, mode="nearest"))


def _lag(making: Making, size: float) -> None:
    making.optics.append(lambda shown: (1.0 - size) * shown + size * shown[[0, *range(len(shown) - 1)]])


def _flat_slope(making: Making, size: float) -> None:
    across = np.linspace(-0.5, 0.5, making.detector.cells)
    odd, even = making.rng.uniform(-size, size, 2)
    making.optics.append(lambda shown: shown * np.exp(-odd * across - even * across**2))


def _view_gain(making: Making, size: float) -> None:
    gains = np.exp(size * making.rng.standard_normal((making.views, 1)))
    making.optics.append(lambda shown: shown * gains)


# Modules.
def _joints(making: Making, number: float) -> None:
    detector, rng, frame = making.detector, making.rng, making.frame
    reach = making.drawing.radius_mm * frame.source_to_detector_mm / frame.source_distance_mm
    middle = 0.5 * detector.cells + frame.cor_column_mm / detector.pitch_mm
    half = reach / detector.pitch_mm - FROM_EDGE
    first = max(int(middle - half), FROM_EDGE)
    last = min(int(middle + half), detector.cells - FROM_EDGE)
    spots = np.sort(rng.choice(np.arange(first, last, 2 * FROM_EDGE), min(int(number), 3), replace=False))
    modules = []
    for cell in spots.tolist():
        gap_mm = detector.pitch_mm * math.exp(rng.uniform(math.log(0.1), math.log(3.0)))
        kink_deg = math.exp(rng.uniform(math.log(0.05), math.log(3.0)))
        shown = rng.choice(3)  # a gap, a kink, or both
        modules.append(
            DetectorModule(
                int(cell) + int(rng.integers(-FROM_EDGE // 2, FROM_EDGE // 2)),
                (gap_mm if rng.random() < 0.8 else -0.5 * gap_mm) if shown != 1 else 0.0,
                math.radians(making.either(kink_deg)) if shown != 0 else 0.0,
            )
        )
    making.detector = replace(detector, modules=tuple(modules))


# Mechanics.
def _wobble(making: Making, size: float) -> None:
    order, start = int(making.rng.integers(1, 5)), making.rng.uniform(0.0, 2.0 * math.pi)
    making.move_scanner(np.cos(order * making.angles_rad + start), size)


def _slip(making: Making, size: float) -> None:
    after = (np.arange(making.views) >= making.split()).astype(float)
    making.move_phantom(after, size)
    making.turned_rad += after * making.either(size) / making.drawing.radius_mm * making.rng.choice(2)


def _jump(making: Making, size: float) -> None:
    making.move_scanner((np.arange(making.views) >= making.split()).astype(float), size)


def _creep(making: Making, size: float) -> None:
    making.move_phantom(making.progress(), size)


def _three_slips(making: Making, size: float) -> None:
    first, last = int(0.12 * making.views), int(0.88 * making.views)
    for view in making.rng.choice(np.arange(first, last), 3, replace=False):
        making.move_phantom((np.arange(making.views) >= view).astype(float), size)


def _lean(making: Making, size: float) -> None:
    making.move_phantom(-np.exp(-(making.progress() + 0.5) / making.rng.uniform(0.1, 0.4)), size)


def _wobble_times(order: float) -> Callable[[Making, float], None]:
    def wobble(making: Making, size: float) -> None:
        making.move_scanner(np.cos(order * making.angles_rad + making.rng.uniform(0.0, 6.28)), size)

    return wobble


def _in_blocks(making: Making, size: float) -> None:
    """Put the phantom elsewhere in each of four to eight blocks of views, turned too in every second scan."""
    count = int(making.rng.integers(4, 9))
    block = np.minimum(np.arange(making.views) * count // making.views, count - 1)
    x, y, turn = (making.rng.standard_normal((count, 3)) * size)[block].T
    beta = making.angles_rad + making.frame.psi_rad
    making.moved_mm += np.stack([np.cos(beta) * x + np.sin(beta) * y, np.cos(beta) * y - np.sin(beta) * x], -1)
    making.turned_rad += turn / making.drawing.radius_mm * making.rng.choice(2)


def _warm_up(making: Making, size: float) -> None:
    making.move_scanner(np.exp(-(making.progress() + 0.5) / making.rng.uniform(0.1, 0.6)), size)


def _encoder(making: Making, size: float) -> None:
    order, start = int(making.rng.integers(1, 4)), making.rng.uniform(0.0, 2.0 * math.pi)
    making.turned_rad += math.radians(size) * np.cos(order * making.angles_rad + start)


def _pace(making: Making, size: float) -> None:
    making.turned_rad += making.either(size) * 2.0 * math.pi * making.progress()


def _jitter(making: Making, size: float) -> None:
    making.turned_rad += math.radians(size) * making.rng.standard_normal(making.views)


# Wood.
def _mapped(making: Making, move: Callable[[FloatArray], FloatArray], pieces: int = 1) -> None:
    """Move every point of the outlines, whose sides have this number of pieces."""
    shapes: list[Polygon | Disc] = []
    for shape in making.shapes:
        if isinstance(shape, Disc):
            centre = move(np.array([shape.center_mm]))[0]
            shapes.append(replace(shape, center_mm=(float(centre[0]), float(centre[1]))))
        else:
            shapes.append(_of_corners(shape, move(_divided(np.array(shape.vertices_mm, float), pieces))))
    making.shapes = shapes


def _divided(corners: FloatArray, pieces: int) -> FloatArray:
    along = (np.arange(pieces) / pieces)[None, :, None]
    points: FloatArray = corners[:, None] + along * (np.roll(corners, -1, axis=0) - corners)[:, None]
    return points.reshape(-1, 2)


def _of_corners(shape: Polygon, corners: FloatArray) -> Polygon:
    return replace(shape, vertices_mm=tuple((float(x), float(y)) for x, y in corners))


def _moisture(making: Making, size: float) -> None:
    way = making.rng.uniform(0.0, 2.0 * math.pi)
    making.slope_per_mm = (size / 100.0 * math.cos(way), size / 100.0 * math.sin(way))


def _deformation(making: Making, size: float) -> None:
    aspect, shear, of_x = making.either(size), making.rng.uniform(-size, size), making.rng.random()
    x, y = 1.0 + of_x * aspect, 1.0 - (1.0 - of_x) * aspect
    _mapped(making, lambda p: np.stack([x * p[:, 0] + 0.5 * shear * p[:, 1], y * p[:, 1] + 0.5 * shear * p[:, 0]], -1))


def _corners(making: Making, size: float) -> None:
    making.shapes = [_rounded(shape, size) if isinstance(shape, Polygon) else shape for shape in making.shapes]


def _rounded(shape: Polygon, radius_mm: float) -> Polygon:
    """Return the polygon with arcs for its right-angled corners, those that point inwards excepted."""
    corners = np.array(shape.vertices_mm, float)
    to_last, to_next = np.roll(corners, 1, axis=0) - corners, np.roll(corners, -1, axis=0) - corners
    to_last, to_next = (way / np.hypot(*way.T)[:, None] for way in (to_last, to_next))
    turns = to_next[:, 0] * to_last[:, 1] - to_next[:, 1] * to_last[:, 0]
    angles = np.linspace(0.0, 0.5 * math.pi, PIECES)[:, None]
    points: list[FloatArray] = []
    for corner, last, following, turn in zip(corners, to_last, to_next, turns, strict=True):
        if turn * turns.sum() > 0.0:
            centre = corner + radius_mm * (last + following)
            points.append(centre - radius_mm * (np.cos(angles) * following + np.sin(angles) * last))
        else:
            points.append(corner[None])
    return _of_corners(shape, np.concatenate(points))


def _knots(making: Making, size: float) -> None:
    outline = making.shapes[0]
    assert isinstance(outline, Polygon)
    wood = outline.density
    for _ in range(int(making.rng.integers(1, 5))):
        # A knot lies beside the middle of a side that two corners share.
        corners = np.array(outline.vertices_mm, float)
        way = making.rng.dirichlet([1.0, 1.0, 1.0])
        first = int(making.rng.integers(len(corners)))
        x, y = way @ corners[[first - 1, first, (first + 1) % len(corners)]]
        making.shapes.append(Disc((float(x), float(y)), making.rng.uniform(3.0, 12.0), size * wood))


def _core(making: Making, size: float) -> None:
    outline = making.shapes[0]
    assert isinstance(outline, Polygon)
    corners = np.array(outline.vertices_mm, float)
    depth = making.rng.uniform(0.3, 0.8)
    inner = corners.mean(axis=0) + depth * (corners - corners.mean(axis=0))
    making.shapes.append(replace(_of_corners(outline, inner), density=making.either(size) * outline.density))


def _bow(making: Making, size: float) -> None:
    reach = making.drawing.radius_mm
    bow = making.either(size)
    _mapped(making, lambda p: np.stack([p[:, 0] + bow * ((p[:, 1] / reach) ** 2 - 0.5), p[:, 1]], -1), PIECES)


@dataclass(frozen=True)
class Effect:
    """An effect and the range of its sizes, which are log-uniform; the unit is in the comment of the table."""

    low: float
    high: float
    make: Callable[[Making, float], None]


BEAM = {
    "hardening": Effect(0.1, 1.5, _hardening),  # second energy's attenuation beyond the first's, share
    "scatter": Effect(0.005, 0.05, _scatter),  # of the intensity that the phantom takes out, share
    "blur": Effect(0.3, 1.5, _blur),  # standard deviation, cells
    "lag": Effect(0.003, 0.05, _lag),  # share of the view before
    "flat slope": Effect(0.003, 0.04, _flat_slope),  # from end to end, share
    "view gain": Effect(0.001, 0.01, _view_gain),  # standard deviation, share
}
MODULES = {"joints": Effect(1.0, 4.0, _joints)}  # their number, rounded down
MECHANICS = {
    "wobble": Effect(0.03, 0.5, _wobble),  # amplitude, mm
    "slip": Effect(0.05, 0.6, _slip),  # mm
    "jump": Effect(0.05, 0.5, _jump),  # mm
    "creep": Effect(0.05, 0.6, _creep),  # over the scan, mm
    "warm-up": Effect(0.05, 0.5, _warm_up),  # mm
    "encoder": Effect(0.02, 0.4, _encoder),  # amplitude, degrees
    "pace": Effect(0.0002, 0.004, _pace),  # share of the turn
    "jitter": Effect(0.005, 0.1, _jitter),  # standard deviation, degrees
}
# Effects that change the outline by its corners come first: `_corners` needs right angles.
WOOD = {
    "corners": Effect(0.5, 8.0, _corners),  # radius, mm
    "moisture": Effect(0.01, 0.15, _moisture),  # share in 100 mm
    "core": Effect(0.01, 0.1, _core),  # density against the skin's, share
    "deformation": Effect(0.001, 0.01, _deformation),  # aspect, share
    "bow": Effect(0.05, 1.5, _bow),  # mm at the rim
    "knots": Effect(0.05, 0.6, _knots),  # density beyond the wood's, share
}
FAMILIES = {
    "beam and detector": BEAM,
    "modules": MODULES,
    "mechanics": MECHANICS,
    "wood": WOOD,
    "few views": WOOD | BEAM | MECHANICS,
}


# Motions that the families do not have: sizes as in the table above.
OTHER_MOTIONS = {
    "three slips": Effect(0.3, 0.4, _three_slips),  # each, mm
    "lean": Effect(0.8, 0.8, _lean),  # until it has settled, mm
    "wobble 1.5 times": Effect(0.1, 0.5, _wobble_times(1.5)),  # amplitude, mm
    "wobble 5 times": Effect(0.1, 0.5, _wobble_times(5.0)),  # amplitude, mm
    "blocks": Effect(0.1, 0.4, _in_blocks),  # standard deviation, mm
}


def otherwise_moved(motion: str, seed: int) -> Making:
    """Draw a scan whose phantom moves otherwise than once or twice, or steadily."""
    rng = np.random.default_rng([seed, list(OTHER_MOTIONS).index(motion), 47])
    making, effect = _undisturbed(rng, (72, 90, 120)), OTHER_MOTIONS[motion]
    effect.make(making, rng.uniform(effect.low, effect.high))
    return making


@dataclass(frozen=True)
class FamilyScan:
    """Scan `number` of a family; all of it follows from family, number and seed."""

    making: Making
    sizes: dict[str, float]
    seed: int

    @classmethod
    def of(cls, family: str, number: int, seed: int = 1) -> "FamilyScan":
        """Draw the scan."""
        rng = np.random.default_rng([seed, list(FAMILIES).index(family), number])
        making = _undisturbed(rng, FEW_VIEWS if family == "few views" else VIEWS)
        effects = FAMILIES[family]
        chosen = list(rng.choice(list(effects), min(int(rng.integers(1, 4)), len(effects)), replace=False))
        if family == "modules":
            chosen += rng.choice(list(BEAM), int(rng.integers(0, 3)), replace=False).tolist()
        sizes = {}
        for name, effect in (WOOD | MODULES | BEAM | MECHANICS).items():
            if name in chosen:
                size = math.exp(rng.uniform(math.log(effect.low), math.log(effect.high)))
                sizes[name] = size * (MILD if family == "few views" else 1.0)
                effect.make(making, sizes[name])
        return cls(making, sizes, int(rng.integers(2**31)))

    @property
    def task(self) -> CalibrationTask:
        """The calibration of this scan, with noise of its own."""
        return self.making.task(self.seed)


def _undisturbed(rng: np.random.Generator, choice: tuple[int, ...] | range) -> Making:
    """Draw scanner, views, phantom and its pose; the phantom's size is as uncertain as its drawing says."""
    drawing = L_SHAPE if rng.random() < 0.75 else RECTANGLE_WITH_HOLE
    views = int(rng.choice(list(choice)))
    frame = SourceFrame(
        rng.uniform(0.0, 2.0 * math.pi),
        rng.uniform(870.0, 960.0),
        rng.uniform(1500.0, 1700.0),
        rng.uniform(-150.0, 100.0),
        rng.uniform(-0.1, 0.1),
    )
    angles = rng.uniform(0.0, 2.0 * math.pi) + np.linspace(0.0, 2.0 * math.pi, views, endpoint=False)
    size = 1.0 + drawing.size_tolerance * rng.standard_normal()
    body = drawing.scaled(size).moved(*rng.uniform(-20.0, 20.0, 2)).of_density(rng.uniform(0.004, 0.009))
    photons = math.exp(rng.uniform(math.log(5e3), math.log(1e5)))
    return Making(rng, drawing, frame, Detector(768, 1.5028), angles, photons, list(body.shapes))
