"""The distance between the rays of two geometries, up to a common scale (docs/look-up/conventions.md#ray-error)."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sawmill_tomography.geometry.detector_shape import cell_centres_mm, cell_points, lines_of, wave_shapes
from sawmill_tomography.geometry.fit_parameters import FitParameter
from sawmill_tomography.geometry.geometry import TAU, FloatArray, GeometryError, Scanner, SourceFrame
from sawmill_tomography.statistics import exceeded_chi_square
from sawmill_vocabulary.geometry import MOST_WAVES

POINTS_PER_CHORD = 9
# Of the points, every fourth is enough for a prediction: each of the nine places on a chord is as often among them.
PREDICTED_AT = 4
DRAWS = 4096
# Degrees of freedom of the error that no parameter has: of the estimate of its variance.
FREEDOM = 8
# Rings of places in a log, and points on each: twice as many change no loss of contrast by 1 %.
RINGS, POINTS_PER_RING = 6, 60


@dataclass(frozen=True)
class RayError:
    """Distances in mm inside the disc, after the common rotation and the common scale that make their RMS least."""

    rms_mm: float
    max_mm: float
    scale_change: float  # relative difference of the image sizes: R is larger by it, with SDD, u_c and tau unchanged


def _rays(scanner: Scanner, frame: SourceFrame) -> tuple[FloatArray, FloatArray]:
    """Return source (2,) and unit ray directions (cells, 2) of the view at which the source lies on -y."""
    return _rays_to(cell_points(scanner, frame), frame)


def _rays_to(ends_mm: FloatArray, frame: SourceFrame) -> tuple[FloatArray, FloatArray]:
    return np.array([0.0, -frame.source_distance_mm]), ends_mm / np.hypot(*ends_mm.T)[:, None]


def chord_points(scanner: Scanner, frame: SourceFrame, radius_mm: float) -> tuple[FloatArray, NDArray[np.intp]]:
    """Return nine equidistant points of the chord that each ray cuts from the disc.

    `points` (rays, 9, 2) mm. `cells` (rays,) int: the detector cells whose rays meet the disc.
    """
    return _chord_points(*_rays(scanner, frame), radius_mm)


def _chord_points(source: FloatArray, direction: FloatArray, radius_mm: float) -> tuple[FloatArray, NDArray[np.intp]]:
    along = -(direction @ source)
    half = radius_mm**2 - (source @ source - along**2)
    cells = np.flatnonzero(half > 0.0)
    if cells.size == 0:
        raise GeometryError(f"no ray of this geometry meets the disc of radius {radius_mm:.4g} mm")
    half = np.sqrt(half[cells])
    s = along[cells, None] + half[:, None] * np.linspace(-1.0, 1.0, POINTS_PER_CHORD)
    return source + s[..., None] * direction[cells, None, :], cells


def _distances(
    scanner: Scanner, frame: SourceFrame, points: FloatArray, cells: NDArray[np.intp], turn: float, shrink: float
) -> tuple[FloatArray, FloatArray]:
    """Return distances (rays, 9) to a frame's rays, turned and R times shrink, and both derivatives (2, rays, 9)."""
    source, direction = _rays(scanner, frame)
    normal = np.stack([-direction[:, 1], direction[:, 0]], -1)[cells]
    c, s = math.cos(turn), math.sin(turn)
    back = points @ np.array([[c, -s], [s, c]])
    offset = normal @ source
    d = np.einsum("rc,rpc->rp", normal, back) - shrink * offset[:, None]
    by_turn = np.einsum("rc,rpc->rp", normal, np.stack([back[..., 1], -back[..., 0]], -1))
    return d, np.stack([by_turn, np.broadcast_to(-offset[:, None], d.shape)])


def ray_error(
    scanner: Scanner,
    true: SourceFrame,
    other: SourceFrame,
    *,
    radius_mm: float = 150.0,
    other_scanner: Scanner | None = None,
) -> RayError:
    """Compute the RMS and maximum distance between the rays of two geometries inside a disc around the COR.

    `other_scanner` is the scanner of the other geometry, where its modules differ; None: the same scanner.

    It does not depend on theta's gauge (the twin has 0). One common rotation and one common scale are removed: psi has
    no effect, and R only in `scale_change`.
    """
    return nearest_rays(cell_points(scanner, true), true, other_scanner or scanner, other, radius_mm=radius_mm)


def nearest_rays(
    ends_mm: FloatArray, true: SourceFrame, scanner: Scanner, other: SourceFrame, *, radius_mm: float = 150.0
) -> RayError:
    """Compute `ray_error` for rays from the source to these points, (cells, 2) mm as of `cell_points`."""
    points, cells = _chord_points(*_rays_to(ends_mm, true), radius_mm)
    turn, shrink = 0.0, 1.0
    for _ in range(20):
        d, slope = _distances(scanner, other, points, cells, turn, shrink)
        step = np.linalg.lstsq(slope.reshape(2, -1).T, -d.ravel())[0]
        turn, shrink = turn + float(step[0]), shrink + float(step[1])
        if np.abs(step).max() < 1e-15:
            break
    d, _ = _distances(scanner, other, points, cells, turn, shrink)
    return RayError(float(np.sqrt(np.mean(d * d))), float(np.abs(d).max()), 1.0 / shrink - 1.0)


def scale_gradient(scanner: Scanner, frame: SourceFrame, *, radius_mm: float = 150.0) -> FloatArray:
    """Return the derivatives of `ray_error`'s scale change by (psi, R, SDD, u_c, tau), (5,), per rad and per mm.

    A bias of these five changes the scale by gradient @ bias.
    """
    return _linear(scanner, frame, *chord_points(scanner, frame, radius_mm)).scale[:5]


def scale_deviation(scanner: Scanner, frame: SourceFrame, covariance: FloatArray, *, radius_mm: float = 150.0) -> float:
    """Predict the scale's standard deviation, a share, from a covariance of (psi, R, SDD, u_c, tau)."""
    gradient = scale_gradient(scanner, frame, radius_mm=radius_mm)
    return math.sqrt(max(float(gradient @ covariance @ gradient), 0.0))


def scale_ray_error(scanner: Scanner, frame: SourceFrame, scale: float, *, radius_mm: float = 150.0) -> float:
    """Compute the RMS distance, mm, to the rays of a geometry with R larger by a share, one rotation removed.

    A phantom that is larger than stated makes R larger by the same share and changes nothing else
    (docs/understand/verdict.md#the-scale).
    """
    points, cells = chord_points(scanner, frame, radius_mm)
    _, (by_turn, by_shrink) = _distances(scanner, frame, points, cells, 0.0, 1.0)
    by_shrink = by_shrink - by_turn * float(np.sum(by_turn * by_shrink) / np.sum(by_turn * by_turn))
    return abs(scale) * float(np.sqrt(np.mean(by_shrink * by_shrink)))


@dataclass(frozen=True, eq=False)
class _Linear:
    """Derivatives by (psi, R, SDD, u_c, tau) of the distances, rotation and scale removed, and of the scale.

    Derivatives by the gap and the kink of each module follow, then those of further borders.
    """

    distances: FloatArray
    scale: FloatArray


def _linear(
    scanner: Scanner,
    frame: SourceFrame,
    points: FloatArray,
    cells: NDArray[np.intp],
    hidden_cells: Sequence[int] = (),
    *,
    of_places: bool = False,
) -> _Linear:
    derivative = _derivatives(scanner, frame, points, cells, hidden_cells, of_places=of_places)
    _, slope = _distances(scanner, frame, points, cells, 0.0, 1.0)
    free = slope.reshape(2, -1).T
    taken = np.linalg.pinv(free.T @ free, hermitian=True) @ (free.T @ derivative)
    return _Linear(derivative - free @ taken, taken[1])


def _derivatives(
    scanner: Scanner,
    frame: SourceFrame,
    points: FloatArray,
    cells: NDArray[np.intp],
    hidden_cells: Sequence[int],
    *,
    of_places: bool,
) -> FloatArray:
    """Return the derivatives of distances (points, parameters) as in `_Linear`, then of places; psi has none."""
    source, direction = _rays(scanner, frame)
    e = direction[cells]
    x, y = cell_points(scanner, frame)[cells].T
    c, s, sdd = math.cos(frame.tilt_rad), math.sin(frame.tilt_rad), frame.source_to_detector_mm
    # Movements of the cells, which form one body, by SDD, u_c and tau, and of the cells on one side of each joint.
    moves = [(np.zeros(x.size), np.ones(x.size)), (np.full(x.size, -c), np.full(x.size, -s)), (sdd - y, x)]
    moves += _module_moves(scanner, frame, cells, (x, y), [module.first_cell for module in scanner.detector_modules])
    if of_places:
        depth = 0.5 * cell_centres_mm(scanner)[cells] ** 2
        moves.append((depth * s, -depth * c))
        moves += [(w * c, w * s) for w in wave_shapes(MOST_WAVES, cells, scanner.num_detector_pixels)]
    moves += _module_moves(scanner, frame, cells, (x, y), hidden_cells)
    # A ray turns about the source by (x dy - y dx) / (x^2 + y^2) when its cell moves by (dx, dy).
    turns = np.stack([x * dy - y * dx for dx, dy in moves]) / (x * x + y * y)
    along = np.einsum("rpc,rc->rp", points - source, e)
    by_r = np.broadcast_to(e[:, :1], along.shape)
    columns = np.stack([np.zeros_like(along), by_r, *(-along * turns[..., None])], -1)
    return columns.reshape(-1, columns.shape[-1])


def _module_moves(
    scanner: Scanner,
    frame: SourceFrame,
    cells: NDArray[np.intp],
    points: tuple[FloatArray, FloatArray],
    first_cells: Sequence[int],
) -> list[tuple[FloatArray, FloatArray]]:
    """Return the movements (x, y) of cells, which lie at these points, by gap and kink of modules that begin there."""
    lines, (x, y) = lines_of(scanner, frame), points
    moves: list[tuple[FloatArray, FloatArray]] = []
    for cell in first_cells:
        right = cell > scanner.num_detector_pixels // 2
        # The joint is the end of the module that is nearer to the middle.
        near = np.searchsorted(lines.end, cell - right, side="right")
        side = (cells >= cell).astype(np.float64) - float(not right)
        c, s = math.cos(lines.tilt_rad[near]), math.sin(lines.tilt_rad[near])
        w = (cell - 0.5 * scanner.num_detector_pixels) * scanner.detector_pitch_mm - lines.cor_column_mm[near]
        moves.append((side * c, side * s))
        moves.append((side * (lines.sdd_mm[near] + w * s - y), side * (x - w * c)))
    return moves


def ray_error_of_bias(scanner: Scanner, frame: SourceFrame, bias: FloatArray, *, radius_mm: float = 150.0) -> float:
    """Compute the RMS ray error, mm, of a frame with a bias of (psi, R, SDD, u_c, tau), (5,), to first order."""
    distances = _linear(scanner, frame, *chord_points(scanner, frame, radius_mm)).distances[:, : len(bias)] @ bias
    return float(np.sqrt(np.mean(distances * distances)))


@dataclass(frozen=True)
class RayErrorPrediction:
    """Ray error inside the disc, predicted from a covariance."""

    rms_mm: float  # root of the expected mean square
    max_mm: float  # standard deviation at the worst point
    upper_95_mm: float  # the RMS ray error stays below this in 95 of 100 cases
    interval_95_mm: tuple[float, float]  # (low, high): the RMS ray error lies in this interval in 95 of 100 cases
    hidden_mm: float = 0.0  # RMS over the cases of what the alternatives add


@dataclass(frozen=True, eq=False)
class RayAlternatives:
    """Errors of which at most one is real, each with a probability: modules that a scan does not show."""

    first_cells: NDArray[np.intp]  # (n,) int: first cells of the modules
    moves: FloatArray  # (n, 2): gap, mm, and kink, rad, of each module
    errors: FloatArray  # (n, 5 + 2 modules): errors of the geometry and of the known modules in each case
    number: NDArray[np.intp]  # (m,) int
    factors: FloatArray  # (m,)
    probabilities: FloatArray  # (m,)


@dataclass(frozen=True, eq=False)
class RayErrorMixture:
    """Draws of further errors, by all that may be real instead of what was fitted."""

    errors: FloatArray  # (n, 5 + 2 modules)
    draws: int  # number of draws, of which the remaining ones have no further error


@dataclass(frozen=True, eq=False)
class ViewErrors:
    """Drawn errors of a geometry and, at the same time, of the poses of its views."""

    errors: FloatArray  # (draws, 5 + 2 modules): errors of the geometry and of the places of cells
    poses: FloatArray  # (draws, views, 3): errors of roll, rad, and of both shifts: across and along the beam, mm
    axes: FloatArray  # (views, 3, 3): changes of (psi, t_x, t_y) by the three


def predicted_ray_error(
    scanner: Scanner,
    frame: SourceFrame,
    covariance: FloatArray,
    alternatives: Sequence[RayAlternatives] = (),
    mixture: RayErrorMixture | None = None,
    *,
    radius_mm: float = 150.0,
    further_mm: float = 0.0,
    of_views: ViewErrors | None = None,
) -> RayErrorPrediction:
    """Predict the ray error from a covariance of (psi, R, SDD, u_c, tau), to first order.

    The covariance may go on with the gap and the kink of each module, then with the detector's curvature (1/mm) and
    waves (mm). Of each of the `alternatives` at most one is real; they and the `mixture` count in the limits only.
    `further_mm` is the RMS error that no parameter has. `of_views` replaces the drawn errors, the mixture's too.

    The mean square of the ray error is a quadratic form in the parameters' errors, with the mean outer product of each
    point's derivatives; the common rotation and scale are projected out of the derivatives as `ray_error` removes them
    from the distances. `scale_deviation` returns the scale's own error.
    """
    points, cells = chord_points(scanner, frame, radius_mm)
    ray, on_chord = np.divmod(np.arange(0, points[..., 0].size, PREDICTED_AT), POINTS_PER_CHORD)
    hidden = sorted({cell for each in alternatives for cell in each.first_cells.tolist()})
    of_places = len(covariance) > 5 + 2 * len(scanner.detector_modules)
    distances = _linear(
        scanner, frame, points[ray, on_chord][:, None], cells[ray], hidden, of_places=of_places
    ).distances
    derivative = distances[:, : len(covariance)]
    variance = (derivative @ covariance * derivative).sum(axis=1) + further_mm**2
    form = derivative.T @ derivative / len(derivative)
    # A sum of weighted chi-squares has no closed quantile: seeded draws give it to 2 %.
    rng = np.random.default_rng(0)
    if of_views is None:
        errors = _drawn_errors(form, covariance, mixture, rng)
        squares = (errors @ form * errors).sum(axis=1)
    else:
        at = points[ray, on_chord], cells[ray]
        squares, variance = _of_views(scanner, frame, at, of_views, rng, of_places=of_places)
        # What modules hide adds to errors that the poses have taken up.
        errors = np.zeros((DRAWS, len(covariance)))
    if further_mm:
        squares += further_mm**2 * FREEDOM / rng.chisquare(FREEDOM, DRAWS)
    moves = _ModuleMoves.of(form, derivative, hidden, distances[:, distances.shape[1] - 2 * len(hidden) :])
    by_hidden = sum((moves.added_squares(each, errors, rng) for each in alternatives), np.zeros(DRAWS))
    squares += by_hidden
    low, upper, high = np.sqrt(np.maximum(np.quantile(squares, [0.025, 0.95, 0.975]), 0.0)).tolist()
    rms, most, hidden = np.sqrt(np.maximum([variance.mean(), variance.max(), by_hidden.mean()], 0.0)).tolist()
    return RayErrorPrediction(rms, most, upper, (low, high), hidden)


def _of_views(
    scanner: Scanner,
    frame: SourceFrame,
    at: tuple[FloatArray, NDArray[np.intp]],
    of_views: ViewErrors,
    rng: np.random.Generator,
    *,
    of_places: bool,
) -> tuple[FloatArray, FloatArray]:
    """Return mean squares (`DRAWS`,) and variances (points, views) of distances, the best common motion removed."""
    (points, cells), (views, count) = at, (len(of_views.axes), of_views.errors.shape[1])
    _, direction = _rays(scanner, frame)
    normal = np.stack([-direction[:, 1], direction[:, 0]], -1)[cells]
    roll = normal[:, 0] * points[:, 1] - normal[:, 1] * points[:, 0]
    by_frame = _derivatives(scanner, frame, points[:, None], cells, (), of_places=of_places)[:, :count]
    derivative = np.column_stack([by_frame, roll, normal])
    form = derivative.T @ derivative / len(derivative)
    common = np.zeros((views, count + 3, 4))
    common[:, count:, :3], common[:, FitParameter.R, 3] = np.linalg.inv(of_views.axes), 1.0
    formed = form @ common
    of_draws = np.broadcast_to(of_views.errors[:, None], (len(of_views.errors), views, count))
    errors = np.concatenate([of_draws, of_views.poses], axis=2)
    least = np.linalg.pinv(np.einsum("vni,vnj->ij", common, formed), hermitian=True)
    errors = errors - np.einsum("vni,dvm,vmj,ji->dvn", common, errors, formed, least, optimize=True)
    products = np.einsum("dvm,dvn->vmn", errors, errors, optimize=True) / len(errors)
    squares = ((errors @ form) * errors).sum(axis=2).mean(axis=1)
    # The variances of the poses are estimated from as many numbers.
    freedom = of_views.poses[0].size
    squares = np.resize(squares, DRAWS) * freedom / rng.chisquare(freedom, DRAWS)
    return squares, np.einsum("pm,vmn,pn->pv", derivative, products, derivative, optimize=True)


def _drawn_errors(
    form: FloatArray, covariance: FloatArray, mixture: RayErrorMixture | None, rng: np.random.Generator
) -> FloatArray:
    """Draw errors of the parameters, (draws, n)."""
    errors: FloatArray = rng.standard_normal((DRAWS, len(covariance))) @ _weights(form, covariance)[1].T
    if mixture is not None:
        drawn = rng.integers(mixture.draws, size=DRAWS)
        real = drawn < len(mixture.errors)
        errors[real] += mixture.errors[drawn[real]]
    return errors


@dataclass(frozen=True, eq=False)
class _ModuleMoves:
    """Mean products of the points' distances by the known parameters, and by a gap and a kink before each hidden cell.

    All are from the same points: a module that begins elsewhere takes back what the known one moves.
    """

    cells: list[int]  # the hidden cells, in order
    known: FloatArray  # (n, n)
    crossed: FloatArray  # (cells, n, 2)
    own: FloatArray  # (cells, 2, 2)

    @classmethod
    def of(cls, known: FloatArray, derivative: FloatArray, hidden: list[int], moved: FloatArray) -> "_ModuleMoves":
        """Compute the products from the points' derivatives by the known parameters, and by the hidden cells' moves."""
        count = len(derivative)
        moves = moved.reshape(count, -1, 2)
        return cls(
            hidden,
            known,
            np.einsum("pk,pcm->ckm", derivative, moves, optimize=True) / count,
            np.einsum("pcm,pcn->cmn", moves, moves) / count,
        )

    def added_squares(self, each: RayAlternatives, errors: FloatArray, rng: np.random.Generator) -> FloatArray:
        """Draw what one of the alternatives adds to the mean squares of these errors, (draws,)."""
        place = np.searchsorted(self.cells, each.first_cells)
        by_known = (self.crossed[place] @ each.moves[..., None])[..., 0]
        formed = each.errors @ self.known
        own = ((formed + 2.0 * by_known) * each.errors).sum(axis=1)
        own += np.einsum("nm,nmo,no->n", each.moves, self.own[place], each.moves)
        drawn = np.searchsorted(np.cumsum(each.probabilities), rng.random(DRAWS))
        real = np.flatnonzero(drawn < each.number.size)
        number, factor = each.number[drawn[real]], each.factors[drawn[real]]
        added = np.zeros(DRAWS)
        added[real] = factor * (factor * own[number] + 2.0 * (errors[real] * (formed + by_known)[number]).sum(axis=1))
        return added


def ring_displacements(
    scanner: Scanner, frame: SourceFrame, parameters: int, *, radius_mm: float
) -> tuple[FloatArray, FloatArray]:
    """Return how far errors displace rays through places of a log, (rings, points, parameters), mm, and the weights.

    A place sees in the views of a full turn what the points of a ring see in the source frame; rings have equal shares
    of the disc. What moves a place, and blurs nothing, is removed. The parameters are those of `predicted_ray_error`.
    The weights (rings, points) are shares in the mean over directions and places; 0 where no ray meets the detector.
    """
    turn = np.exp(1j * TAU * (np.arange(POINTS_PER_RING) + 0.5) / POINTS_PER_RING)
    places = radius_mm * np.sqrt((np.arange(RINGS)[:, None] + 0.5) / RINGS) * turn
    source, direction = _rays(scanner, frame)
    rays, seen = direction @ [1.0, 1j], places - source @ [1.0, 1j]
    angles, fan = np.angle(seen), np.angle(rays)
    # The ray through a place turns by 1 - Re(place / seen) for each radian of the turn.
    weights = np.where((angles - fan.min()) * (angles - fan.max()) < 0.0, 1.0 - (places / seen).real, 0.0)
    cells = np.abs(fan - angles.reshape(-1, 1)).argmin(axis=1)
    points = source + (seen.ravel() * rays[cells].conj()).real[:, None] * direction[cells]
    of_places = parameters > 5 + 2 * len(scanner.detector_modules)
    derivative = _derivatives(scanner, frame, points[:, None], cells, (), of_places=of_places)[:, :parameters]
    displacements = derivative.reshape(*seen.shape, parameters)
    normal = 1j * rays[cells].reshape(seen.shape) * turn.conj()
    shared = np.stack([normal.real, normal.imag], -1)
    weighted = np.swapaxes(shared * weights[..., None], 1, 2)
    moved = np.linalg.pinv(weighted @ shared, hermitian=True) @ (weighted @ displacements)
    return displacements - shared @ moved, weights / max(float(weights.sum()), 1e-9)


def exceeded_ray_error(
    scanner: Scanner, frame: SourceFrame, covariance: FloatArray, share: float, *, radius_mm: float = 150.0
) -> float:
    """Compute the RMS ray error, mm, that a covariance of (psi, R, SDD, u_c, tau) exceeds in this small share of cases.

    The sum of weighted chi-squares is taken as a shifted chi-square with the same first three cumulants, which is right
    far out in the upper tail, where draws would be too few (Imhof, Biometrika 48, 1961, 419-426, section 4).
    """
    points, cells = chord_points(scanner, frame, radius_mm)
    derivative = _linear(scanner, frame, points, cells).distances[:, : len(covariance)]
    weights, _ = _weights(derivative.T @ derivative / len(derivative), covariance)
    if not weights.any():
        return 0.0
    first, second, third = (float(np.sum(weights**power)) for power in (1, 2, 3))
    freedom = second**3 / third**2
    return math.sqrt(first + math.sqrt(second / freedom) * (exceeded_chi_square(share, freedom) - freedom))


def _weights(form: FloatArray, covariance: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return weights (n,) mm^2 of chi-squares that sum to the mean square `form` (n, n), and their errors (n, n)."""
    values, vectors = np.linalg.eigh(covariance)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    weights, turned = np.linalg.eigh(root.T @ form @ root)
    return np.maximum(weights, 0.0), root @ turned
