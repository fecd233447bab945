"""The forward model: what the detector measures of a phantom, with all effects that may be fitted.

The plain model is gain times the drawing's line integrals, plus an offset. Each further effect is a `Term`, with size 0
where the scan does not show the effect. Effects of the beam and the detector act on intensities where the line
integrals were made from counts, and on the line integrals themselves elsewhere.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import IntEnum
from functools import cached_property, lru_cache
from itertools import islice

import numpy as np
import scipy
from numpy.typing import NDArray

from sawmill_tomography.calibration.joint_fit.wood_patches import skin, with_rounded_corners, wood_patches
from sawmill_tomography.calibration.sinogram_data import SinogramData
from sawmill_tomography.geometry.detector_shape import wave_shapes
from sawmill_tomography.geometry.fit_parameters import FRAME, FitParameter
from sawmill_tomography.geometry.geometry import TAU, FloatArray, SourceFrame
from sawmill_tomography.phantoms.phantom import Body, Phantom, Polygon, Shape
from sawmill_tomography.projection import analytic
from sawmill_tomography.projection.analytic import DetectorCells
from sawmill_tomography.sinograms.scattered_radiation import halo
from sawmill_vocabulary.geometry import MOST_WAVES


class Term(IntEnum):
    """An unknown of the forward model, numbered as the derivatives are; the first seven are those in `FitParameter`."""

    PSI = FitParameter.PSI
    R = FitParameter.R
    SDD = FitParameter.SDD
    U_C = FitParameter.U_C
    TILT = FitParameter.TILT
    T_X = FitParameter.T_X
    T_Y = FitParameter.T_Y
    GAIN = 7
    OFFSET = 8
    # Factors of p^2 and p^3, where p is the line integral.
    HARDENING = 9
    HARDENING_CUBIC = 10
    # Slopes of the density, per mm.
    GRADIENT_X = 11
    GRADIENT_Y = 12
    ASPECT = 13
    SHEAR = 14
    # The square of the corners' radius, mm^2.
    CORNERS = 15
    # The square of the blur's standard deviation, in cells.
    BLUR = 16
    # The square of the share of a step over which a view is exposed.
    EXPOSURE = 17
    # Changes across the detector, from end to end: odd, and even.
    SLOPE = 18
    CURVATURE = 19
    # Shares of the intensity: from around, from the whole view, from the view before. They act only on counts.
    SCATTER = 20
    SCATTER_WIDE = 21
    LAG = 22
    # Bows: x moves by this number of mm where y is the drawing's radius, by the square of y; and y by x.
    BOW_X = 23
    BOW_Y = 24
    # Tapers, mm: x, and y, move by the product of x and y.
    TAPER_X = 25
    TAPER_Y = 26
    # Shares by which the wood is denser within 3 mm and within 12 mm of its surface.
    THIN_SKIN = 27
    THICK_SKIN = 28


# Terms that are differentiated only where something else is left in the residual.
WARPS = (Term.BOW_X, Term.BOW_Y, Term.TAPER_X, Term.TAPER_Y)
OF_WOOD = (*WARPS, Term.THIN_SKIN, Term.THICK_SKIN)


class Series(IntEnum):
    """Kinds of terms of which a model has many: they are numbered in turns, after those of `Term`."""

    PATCH = 0  # the share by which the wood is denser in a patch (`wood_patches`)
    WAVE = 1  # the size of a wave by which the detector's cells lie at unequal distances, mm
    ARC = 2  # the detector's curvature, 1/mm: number 0 alone
    GAP = 3  # the gap before a module's first cell, mm
    KINK = 4  # the kink there, rad


def term_of(series: Series, number: int) -> int:
    """Return a term of a series."""
    return len(Term) + len(Series) * number + series


def number_of(term: int) -> int:
    """Return the number of a term in its series: of a gap or a kink the module's first cell."""
    return (term - len(Term)) // len(Series)


def _is_of(term: int | None, *series: Series) -> bool:
    return term is not None and term >= len(Term) and (term - len(Term)) % len(Series) in series


def is_of_patch(term: int | None) -> bool:
    """Return whether a term is the density of the wood in a patch."""
    return _is_of(term, Series.PATCH)


def arc_term() -> int:
    """Return the term of the detector's curvature."""
    return term_of(Series.ARC, 0)


def wave_terms() -> tuple[int, ...]:
    """Return the terms of all waves."""
    return tuple(term_of(Series.WAVE, number) for number in range(MOST_WAVES))


def gap_term(first_cell: int) -> int:
    """Return the term of the gap before a module's first cell, mm."""
    return term_of(Series.GAP, first_cell)


def kink_term(first_cell: int) -> int:
    """Return the term of the kink before a module's first cell, rad."""
    return term_of(Series.KINK, first_cell)


def is_of_detector(term: int | None) -> bool:
    """Return whether a term is a place of the detector's cells: an arc, a wave, a gap or a kink."""
    return _is_of(term, Series.WAVE, Series.ARC, Series.GAP, Series.KINK)


def is_of_module(term: int | None) -> bool:
    """Return whether a term is a gap or a kink."""
    return _is_of(term, Series.GAP, Series.KINK)


def is_kink(term: int) -> bool:
    """Return whether the term of a module is the module's kink."""
    return _is_of(term, Series.KINK)


# The largest sizes of the terms that cannot be negative: 15 mm, 8 cells, a whole step.
LARGEST: dict[int, float] = {Term.CORNERS: 225.0, Term.BLUR: 64.0, Term.EXPOSURE: 1.0}
POSE = (Term.PSI, Term.T_X, Term.T_Y)
# The share of a step over which an exposure is tried: shorter and longer ones are found from it.
TRIED_EXPOSURE = 0.5
SKIN_DEPTHS_MM = {Term.THIN_SKIN: 3.0, Term.THICK_SKIN: 12.0}


@dataclass(frozen=True, eq=False)
class ScanModel:
    """The forward model at one point."""

    drawing: Phantom  # the drawing as this hypothesis of handedness sees it
    data: SinogramData
    from_counts: bool
    x: FloatArray  # (7,): unknowns of the plain model, in the order of `FitParameter`
    gain: FloatArray  # (views, 1)
    offset: FloatArray  # (views, 1)
    pose: FloatArray  # (views, 3): changes of (psi, t_x, t_y) in each view, in radians and mm
    sizes: Mapping[int, float] = field(default_factory=dict)
    view_gain: bool = False  # True if gain and offset differ from view to view
    of_cells: tuple[int, ...] = ()  # terms of arc and waves that are differentiated

    def size(self, term: int) -> float:
        """Return the size of an effect; 0 where the model does not have the effect."""
        return self.sizes.get(term, 0.0)

    @property
    def frame(self) -> SourceFrame:
        """The geometry."""
        return SourceFrame.from_vector(self.x[FRAME])

    @cached_property
    def phantom(self) -> Phantom | Body:
        """The drawing with the model's rounded corners, skins, deformations and patches of other density."""
        wood = self._wood
        if not any(map(is_of_patch, self.sizes)):
            return wood
        edges, begins = self.patch_edges
        densities = np.repeat([self.size(term) for term in self.patch_terms], np.diff(begins))
        patches = np.column_stack([edges[:, :4], edges[:, 4] * densities])
        return Body(wood.name, np.concatenate([wood.edges, patches]), wood.discs, wood.radius_mm)

    @cached_property
    def _wood(self) -> Phantom:
        """The drawing with the model's rounded corners, skins and deformations."""
        return self._warped((*self._rounded, *self._skins))

    @property
    def _rounded(self) -> tuple[Shape, ...]:
        """Shapes of the drawing with rounded corners, before deformations."""
        return with_rounded_corners(self.drawing, math.sqrt(self.size(Term.CORNERS))).shapes

    @property
    def _skins(self) -> tuple[Shape, ...]:
        """Shapes that make the wood denser near its surface, before deformations."""
        return tuple(
            replace(shape, density=shape.density * self.size(term))
            for term, depth_mm in SKIN_DEPTHS_MM.items()
            if self.size(term)
            for shape in skin(self.drawing, depth_mm)
        )

    @property
    def patch_terms(self) -> tuple[int, ...]:
        """The terms of the wood's patches."""
        return tuple(term_of(Series.PATCH, number) for number in range(len(wood_patches(self.drawing))))

    @property
    def patch_edges(self) -> tuple[FloatArray, NDArray[np.intp]]:
        """Edges (edges, 5) of all patches one after another, and where each begins and the last ends (patches + 1,)."""
        return _patch_edges(self.drawing, *self._warp())

    def _warped(self, shapes: Sequence[Shape], more: Term | None = None, by_mm: float = 0.0) -> Phantom:
        """Return a body of these shapes with the model's deformations, one of `WARPS` being larger by `by_mm`."""
        return _warped(self.drawing, shapes, *self._warp(more, by_mm))

    def _warp(self, more: Term | None = None, by_mm: float = 0.0) -> tuple[float, ...]:
        """Return aspect and shear, and the sizes of `WARPS`, one of which is larger by `by_mm`."""
        warps = (self.size(term) + (by_mm if term is more else 0.0) for term in WARPS)
        return self.size(Term.ASPECT), self.size(Term.SHEAR), *warps

    @cached_property
    def clears(self) -> bool:
        """True if the geometry exists and the phantom stays clear of the source."""
        x = self.x
        if (
            not np.isfinite(x).all()
            or abs(x[FitParameter.TILT]) > 1.4
            or not 0.0 < x[FitParameter.R] < x[FitParameter.SDD]
        ):
            return False
        reach = self.phantom.radius_mm + float(np.hypot(*(self.pose[:, 1:] + x[5:]).T).max())
        return analytic.clears(reach, self.frame)

    @property
    def step_rad(self) -> float:
        """Angle between two neighbouring views, rad."""
        return float(np.median(np.diff(np.sort(np.mod(self.data.angles_rad, TAU)))))

    @property
    def kernel_arguments(self) -> tuple[object, ...]:
        """The first arguments of the analytic projection's kernels, for wood of one density.

        What patches of another density change in the derivatives is smaller than a step's own error.
        """
        return analytic.kernel_arguments(
            self._wood,
            self.data.cells,
            self.frame,
            self.data.angles_rad + self.pose[:, 0],
            self.pose[:, 1:] + self.x[5:],
            self.data.rays_per_cell,
        )

    @property
    def detector_terms(self) -> tuple[int, ...]:
        """The terms of the detector's cells, in the order of `detector_rows`."""
        return (*self.module_terms, *self.of_cells)

    @property
    def detector_rows(self) -> FloatArray:
        """Factors (terms, cells) of the derivative by u_c that give the derivatives by `detector_terms`."""
        return np.concatenate([self._module_rows, self.rows_of_cells(self.of_cells)])

    def rows_of_cells(self, terms: Sequence[int]) -> FloatArray:
        """Return the factors (terms, cells) as `detector_rows` does, for some of the terms of arc and waves.

        The ray to a cell of an arc crosses the line that touches it further from the source's foot: by the depth over
        the source's distance from the line.
        """
        u, from_foot = self.by_kink
        waves = wave_shapes(MOST_WAVES, np.arange(u.size), u.size)
        rows = [-0.5 * u**2 * from_foot if term == arc_term() else -waves[number_of(term)] for term in terms]
        return np.reshape(rows, (-1, u.size))

    @cached_property
    def module_terms(self) -> tuple[int, ...]:
        """The terms of all modules."""
        return tuple(
            term
            for module in self.data.cells.modules
            for term in (gap_term(module.first_cell), kink_term(module.first_cell))
        )

    @property
    def _module_rows(self) -> FloatArray:
        cells = self.data.cells
        across_mm, turn = self.by_kink
        rows = np.zeros((len(self.module_terms), cells.count))
        for number, module in enumerate(cells.modules):
            right = module.first_cell > cells.count // 2
            moved = slice(module.first_cell, None) if right else slice(None, module.first_cell)
            border_mm = cells.first_border_mm + cells.width_mm * module.first_cell
            way = 1.0 if right else -1.0
            rows[2 * number, moved] = -way
            rows[2 * number + 1, moved] = way * (across_mm[moved] - border_mm) * turn[moved]
        return rows

    @cached_property
    def by_kink(self) -> tuple[FloatArray, FloatArray]:
        """The cells' coordinate u, and the factor by which a cell that leaves the line shifts along it, (cells,)."""
        cells, frame = self.data.cells, self.frame
        u = cells.first_border_mm + (np.arange(cells.count, dtype=np.float64) + 0.5) * cells.width_mm
        sdd = frame.source_to_detector_mm
        from_foot = u - frame.cor_column_mm + sdd * math.sin(frame.tilt_rad)
        factor: FloatArray = from_foot / (sdd * math.cos(frame.tilt_rad))
        return u, factor

    def project(self, body: Phantom | Body, *, turned: float = 0.0, derivatives: bool = False) -> FloatArray:
        """Compute `analytic.project` for a body in the phantom's pose."""
        return analytic.project(
            body,
            self.data.cells,
            self.frame,
            self.data.angles_rad + self.pose[:, 0] + turned,
            position_mm=self.pose[:, 1:] + self.x[5:],
            rays_per_cell=self.data.rays_per_cell,
            derivatives=derivatives,
        )

    @cached_property
    def deformations(self) -> FloatArray:
        """The phantom's line integrals with derivatives, (12, views, cells)."""
        return self.project(self.phantom, derivatives=True)

    def _line_integrals(self, lengths: FloatArray) -> FloatArray:
        """Apply hardening, the density's slope, gain and offset to the lengths (views, cells)."""
        shape = lengths
        square, cubic = self.size(Term.HARDENING), self.size(Term.HARDENING_CUBIC)
        if square or cubic:
            shape = lengths + square * lengths**2 + cubic * lengths**3
        if self.size(Term.GRADIENT_X) or self.size(Term.GRADIENT_Y):
            x, y = self.deformations[8:10]
            shape = shape + self.size(Term.GRADIENT_X) * x + self.size(Term.GRADIENT_Y) * y
        integrals: FloatArray = self.gain * shape
        integrals += self.offset
        return integrals

    @cached_property
    def lengths(self) -> FloatArray:
        """Line integrals of the phantom in the poses of the views, (views, cells), mm."""
        return self.project(self.phantom)

    @cached_property
    def sharp(self) -> FloatArray:
        """Line integrals (views, cells) before exposure, blur, scatter, lag and the flat field act."""
        return self._line_integrals(self.lengths)

    def _turns(self, share: float) -> list[tuple[float, float]]:
        """Return angles, rad, and weights of a turn by a share of a step: a cell apart where edges are fastest."""
        angle = share * self.step_rad
        fastest_mm = angle * self.phantom.radius_mm * self.x[FitParameter.SDD] / self.x[FitParameter.R]
        at, weights = np.polynomial.legendre.leggauss(2 + int(fastest_mm / self.data.cells.width_mm))
        return list(zip((0.5 * angle * at).tolist(), (0.5 * weights).tolist(), strict=True))

    @property
    def turns_while_exposed(self) -> list[tuple[float, float]]:
        """Angles, rad, by which the phantom turns while a view is exposed, and their weights."""
        square = self.size(Term.EXPOSURE)
        return self._turns(math.sqrt(square)) if square else [(0.0, 1.0)]

    def _mean_over(self, turns: Iterable[tuple[float, float]]) -> FloatArray:
        """Average what the detector measures in turns from each view, with weights, as line integrals."""
        mean = np.zeros_like(self.sharp)
        for turn, weight in turns:
            lines = self._line_integrals(self.project(self.phantom, turned=turn))
            if self.from_counts:
                np.exp(np.negative(lines, out=lines), out=lines)
            lines *= weight
            mean += lines
        return np.negative(np.log(mean, out=mean), out=mean) if self.from_counts else mean

    @cached_property
    def exposure(self) -> FloatArray:
        """Derivative of the line integrals by the square of the exposure's share of a step, (views, cells).

        The mean over a turn changes with the turn by what the mean at both ends is more, divided by it. Where there is
        no exposure yet it is the quotient over `TRIED_EXPOSURE`.
        """
        square = self.size(Term.EXPOSURE)
        if not square:
            half = TRIED_EXPOSURE * self.step_rad / math.sqrt(12.0)  # the two points have the variance of the turn
            return (self._mean_over(((-half, 0.5), (half, 0.5))) - self.sharp) / TRIED_EXPOSURE**2
        end = 0.5 * math.sqrt(square) * self.step_rad
        change = self._mean_over(((-end, 0.5), (end, 0.5))) - self.exposed
        return -np.expm1(-change) / (2.0 * square) if self.from_counts else change / (2.0 * square)

    @cached_property
    def exposed(self) -> FloatArray:
        """Line integrals after rotation during exposure, (views, cells)."""
        return self._mean_over(self.turns_while_exposed) if self.size(Term.EXPOSURE) else self.sharp

    @cached_property
    def taps(self) -> FloatArray:
        """Weights of the blur over neighbouring cells on both sides, (2 n + 1,); empty where there is no blur."""
        square = self.size(Term.BLUR)
        if not square:
            return np.empty(0)
        taps = analytic.blur_taps(math.sqrt(square))
        return np.asarray(np.concatenate([taps[:0:-1], taps]))

    @cached_property
    def blurred(self) -> FloatArray:
        """Line integrals after the blur, (views, cells)."""
        return self._blur(self.exposed) if self.taps.size else self.exposed

    def _blur(self, integrals: FloatArray) -> FloatArray:
        soft: FloatArray = np.exp(-integrals) if self.from_counts else integrals
        soft = scipy.ndimage.correlate1d(soft, self.taps, axis=1, mode="reflect")
        return -np.log(soft) if self.from_counts else soft

    @cached_property
    def halos(self) -> tuple[FloatArray, FloatArray]:
        """Scatter into each cell from around the cell, and from the whole view, against the cell's own intensity."""
        intensity = np.exp(-self.blurred)
        return halo(intensity) / intensity, intensity.mean(axis=1, keepdims=True) / intensity

    @cached_property
    def lagging(self) -> FloatArray:
        """Intensity of the view before less the view's own, as a share of the view's own, (views, cells)."""
        return np.asarray(np.expm1(self.blurred - np.concatenate([self.blurred[:1], self.blurred[:-1]])))

    @cached_property
    def added(self) -> FloatArray:
        """Intensity that scatter and lag add, as a share of the cell's own, (views, cells); at least 5 % remain."""
        around, wide = (self.size(Term.SCATTER), self.size(Term.SCATTER_WIDE))
        total = np.zeros_like(self.blurred)
        if around or wide:
            total += around * self.halos[0] + wide * self.halos[1]
        if self.size(Term.LAG):
            total += self.size(Term.LAG) * self.lagging
        return np.maximum(total, -0.95)

    @cached_property
    def across(self) -> FloatArray:
        """Positions on the detector from -1/2 to 1/2, (cells,)."""
        return (np.arange(self.data.cells.count) + 0.5) / self.data.cells.count - 0.5

    @cached_property
    def prediction(self) -> FloatArray:
        """Model sinogram (views, cells) in the data's unit."""
        model = self.blurred
        if any(self.size(term) for term in (Term.SCATTER, Term.SCATTER_WIDE, Term.LAG)):
            model = model - np.log1p(self.added)
        if self.size(Term.SLOPE) or self.size(Term.CURVATURE):
            model = model + self.size(Term.SLOPE) * self.across + self.size(Term.CURVATURE) * self.across**2
        return model

    @cached_property
    def residual(self) -> FloatArray:
        """Residual: the sinogram less the prediction, (views, cells)."""
        return self.data.sinogram - self.prediction

    @property
    def corner_edges(self) -> FloatArray:
        """Edges (edges, 5) that corners lose with a squared radius larger by 1 mm^2, as the derivative."""
        square = self.size(Term.CORNERS)
        without = with_rounded_corners(self.drawing, math.sqrt(square))
        drawn = len(self.drawing.shapes)
        pieces = (
            *with_rounded_corners(self.drawing, math.sqrt(square + 1.0)).shapes[drawn:],
            *(replace(shape, density=-shape.density) for shape in without.shapes[drawn:]),
        )
        if not pieces:
            return np.empty((0, 5))
        return self._warped(pieces).edges

    def has_skin(self, term: Term) -> bool:
        """Return whether the wood is thicker than this term's skin."""
        return bool(skin(self.drawing, SKIN_DEPTHS_MM[term]))

    def _change_of_body(self, term: Term) -> Phantom | None:
        """Return a body whose line integrals are the derivative of the phantom's by a term of `OF_WOOD`."""
        if term in SKIN_DEPTHS_MM:
            shapes = skin(self.drawing, SKIN_DEPTHS_MM[term])
            return self._warped(shapes) if shapes else None
        # Patches of other density hardly change what a warp does.
        step = float(np.cbrt(np.finfo(np.float64).eps)) * self.drawing.radius_mm
        more, less = (
            self._warped((*self._rounded, *self._skins), term, way * step).of_density(0.5 / (way * step))
            for way in (1.0, -1.0)
        )
        shapes = (*more.shapes, *less.shapes)
        return replace(self.drawing, shapes=shapes)

    @property
    def by_wood(self) -> FloatArray:
        """Derivatives of the prediction by the terms of `OF_WOOD`, (6, views, cells); 0 for a skin of thinner wood."""
        square, cubic = self.size(Term.HARDENING), self.size(Term.HARDENING_CUBIC)
        chain = self.gain * (1.0 + 2.0 * square * self.lengths + 3.0 * cubic * self.lengths**2)
        bodies = [self._change_of_body(term) for term in OF_WOOD]
        rows = np.stack([np.zeros_like(chain) if body is None else chain * self.project(body) for body in bodies])
        if self.taps.size:
            before, after = (np.exp(-self.exposed), np.exp(self.blurred)) if self.from_counts else (1.0, 1.0)
            rows = scipy.ndimage.correlate1d(before * rows, self.taps, axis=2, mode="reflect") * after
        return rows / (1.0 + self.added) if self.from_counts else rows

    def every(self, step: int) -> "ScanModel":
        """Return the model of every `step`-th view, with the same residual there."""
        if step == 1:
            return self
        few = replace(
            self, data=self.data.every(step), gain=self.gain[::step], offset=self.offset[::step], pose=self.pose[::step]
        )
        # A step is longer then, and the views between, which are left out, determine lag.
        few = replace(few, sizes={**self.sizes, Term.EXPOSURE: self.size(Term.EXPOSURE) / step**2})
        return replace(few, data=replace(few.data, sinogram=few.prediction + self.residual[::step]))

    def with_view_gains(self, weights: FloatArray) -> "ScanModel":
        """Return the model with each view's gain and offset from weighted linear regression of the sinogram."""
        # All parts of the model other than gain and offset stay the same.
        shape = (self.sharp - self.offset) / self.gain
        target = self.residual + self.sharp
        total = np.maximum(weights.sum(axis=1, keepdims=True), 1e-300)
        centre = (weights * shape).sum(axis=1, keepdims=True) / total
        level = (weights * target).sum(axis=1, keepdims=True) / total
        power = (weights * (shape - centre) ** 2).sum(axis=1, keepdims=True)
        cross = (weights * (shape - centre) * target).sum(axis=1, keepdims=True)
        seen = power > 1e-9 * power.max()
        gain = np.where(seen, cross / np.where(seen, power, 1.0), self.gain)
        other = replace(self, gain=gain, offset=level - gain * centre, view_gain=True)
        vars(other)["lengths"] = self.lengths
        return other

    def moved(self, scalars: Mapping[int, float], pose: FloatArray) -> "ScanModel":
        """Return the model with these changes of x, gain, offset, sizes and modules, and of the pose of each view."""
        x, sizes = self.x.copy(), dict(self.sizes)
        gain, offset, data = self.gain, self.offset, self.data
        for number, change in scalars.items():
            if is_of_detector(number):
                continue
            if number < Term.GAIN:
                x[number] += change
            elif number == Term.GAIN:
                gain = gain + change
            elif number == Term.OFFSET:
                offset = offset + change
            else:
                size = self.size(number) + change
                sizes[number] = min(max(size, 0.0), LARGEST[number]) if number in LARGEST else size
        if any(is_of_module(term) for term in scalars):
            modules = tuple(
                replace(
                    module,
                    gap_mm=module.gap_mm + scalars.get(gap_term(module.first_cell), 0.0),
                    kink_rad=module.kink_rad + scalars.get(kink_term(module.first_cell), 0.0),
                )
                for module in data.cells.modules
            )
            data = replace(data, cells=replace(data.cells, modules=modules))
        if any(is_of_detector(term) and not is_of_module(term) for term in scalars):
            data = replace(data, cells=_reshaped(data.cells, scalars))
        return replace(self, x=x, gain=gain, offset=offset, sizes=sizes, pose=self.pose + pose, data=data)


def _warped(drawing: Phantom, shapes: Sequence[Shape], aspect: float, shear: float, *warps: float) -> Phantom:
    body = replace(drawing, shapes=tuple(shapes)).deformed(aspect, shear)
    return body.warped((warps[0], warps[1]), (warps[2], warps[3]), drawing.radius_mm)


# Most models of a fit have the same deformations.
@lru_cache(maxsize=4)
def _patch_edges(drawing: Phantom, *warp: float) -> tuple[FloatArray, NDArray[np.intp]]:
    patches = wood_patches(drawing)
    body = _warped(drawing, [shape for shapes in patches for shape in shapes], *warp)
    corners = iter([len(shape.vertices_mm) for shape in body.shapes if isinstance(shape, Polygon)])
    return body.edges, np.cumsum([0, *(sum(islice(corners, len(shapes))) for shapes in patches)])


def _reshaped(cells: DetectorCells, changes: Mapping[int, float]) -> DetectorCells:
    """Return the detector's cells with these changes of arc and waves."""
    curvature = (0.0 if cells.arc_radius_mm is None else 1.0 / cells.arc_radius_mm) + changes.get(arc_term(), 0.0)
    # A detector whose ends are less deep is straight.
    bent = curvature * (cells.count * cells.width_mm) ** 2 > 8.0 * analytic.DEEPEST_MM
    waves = [*cells.waves_mm, *[0.0] * (MOST_WAVES - len(cells.waves_mm))]
    waves = [wave + changes.get(term, 0.0) for wave, term in zip(waves, wave_terms(), strict=True)]
    return replace(cells, arc_radius_mm=1.0 / curvature if bent else None, waves_mm=tuple(waves) if any(waves) else ())
