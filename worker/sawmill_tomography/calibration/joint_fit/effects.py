"""Effects that may be fitted with the geometry: one table of what each adds to the model, reports and advises.

An effect is fitted where its posterior says so (`joint_fit/groups.py`). The effect of a slip, which depends on the
view, is in `slip.py`.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from sawmill_tomography.calibration.joint_fit.normal_equations import Column
from sawmill_tomography.calibration.joint_fit.scan_model import SKIN_DEPTHS_MM, ScanModel, Term, arc_term, wave_terms
from sawmill_tomography.geometry.detector_shape import waves
from sawmill_tomography.geometry.fit_parameters import FitParameter
from sawmill_tomography.geometry.geometry import FloatArray
from sawmill_tomography.projection.analytic import DetectorCells
from sawmill_vocabulary import Adjustment
from sawmill_vocabulary.geometry import MOST_WAVES
from sawmill_vocabulary.messages import Reason
from sawmill_vocabulary.scan_messages import EffectMessage

# An error of the drawing turns with the phantom: this share of it resembles cells that are off.
STAYS = 0.25
# Numbers of times a turn of wobbles, as with a worn bearing; the rarer ones are of a bearing's cage, and of its balls.
_USUAL = {1: "once", 2: "twice", 3: "three times", 4: "four times"}
_RARE = {0.5: "half a time", 1.5: "1.5 times", 2.5: "2.5 times", 5: "five times", 6: "six times"}
# Shares of the scan in which phantom or scanner come to rest.
REST = (0.1, 0.2, 0.4)
# The largest number of waves in time of a motion of any shape; there are at most a third as many as views.
WAVES = 8


@dataclass(frozen=True)
class Effect:
    """An effect in a scan that the plain model does not have."""

    adjustment: Adjustment  # the option that switches the effect off
    columns: Callable[[ScanModel], tuple[Column, ...]]  # unknowns of the effect for a model
    reason: Callable[[ScanModel, FloatArray], Reason]
    possible: Callable[[ScanModel, FloatArray], bool] = lambda _, __: True
    trials: float = 1.0  # number of effects of this kind, of which one at most is real


def _terms(*chosen: Term, counts: bool = False) -> Callable[[ScanModel], tuple[Column, ...]]:
    """Return columns with one term each; none where intensities are needed (`counts`) and the scan has none."""

    def columns(model: ScanModel) -> tuple[Column, ...]:
        if counts and not model.from_counts:
            return ()
        return tuple(Column.of(term) for term in chosen)

    return columns


def _hardening(model: ScanModel, sizes: FloatArray) -> Reason:
    longest = float(model.lengths.max())
    return EffectMessage.BEAM_HARDENING(change_percent=100.0 * float(sizes[0] * longest + sizes[1] * longest**2))


def _scattered_radiation(model: ScanModel, sizes: FloatArray) -> Reason:
    around, wide = model.halos
    added = float((sizes[0] * around + sizes[1] * wide).flat[model.blurred.argmax()])
    if added < 0.0:
        # With the gains of the views, scatter takes up what powers of the paths leave of the hardening.
        return EffectMessage.SCATTER_OR_HARDENING()
    return EffectMessage.SCATTER(added_percent=100.0 * added)


def _pace(model: ScanModel, sizes: FloatArray) -> Reason:
    turned = float(model.data.angles_rad[-1] - model.data.angles_rad[0])
    return EffectMessage.PACE(factor=1.0 + float(sizes[0]) / turned if turned else 1.0)


def _encoder(message: EffectMessage, orders: tuple[int, int]) -> Effect:
    """Return the effect of angles that are ahead and behind these numbers of times a turn, as with a faulty encoder."""

    def reason(_: ScanModel, sizes: FloatArray) -> Reason:
        first, second = np.rad2deg([math.hypot(*sizes[:2]), math.hypot(*sizes[2:])])
        return message(first_deg=float(first), second_deg=float(second))

    return Effect(
        Adjustment.ENCODER,
        lambda model: of_angle([shape for order in orders for shape in harmonics(model, order)]),
        reason,
    )


def _wobble(order: float, times: str, trials: float = 1.0) -> Effect:
    return Effect(
        Adjustment.WOBBLE,
        lambda model: in_the_laboratory(model, [wave - wave.mean() for wave in harmonics(model, order)]),
        lambda _, sizes: EffectMessage.WOBBLE(times=times, wobble_mm=largest_move(sizes)),
        trials=trials,
    )


def _coming_to_rest(share: float) -> tuple[Effect, Effect]:
    """Return the effects of a phantom, and of a scanner, that come to rest in this share of the scan."""

    def shape(model: ScanModel) -> FloatArray:
        gone = np.exp(-(progress(model) + 0.5) / share)
        return np.asarray(gone - gone.mean())

    return (
        Effect(
            Adjustment.CREEP,
            lambda model: of_position([shape(model)]),
            lambda _, sizes: EffectMessage.PHANTOM_SETTLES(settled_mm=math.hypot(*sizes)),
            trials=float(len(REST)),
        ),
        Effect(
            Adjustment.CREEP,
            lambda model: in_the_laboratory(model, [shape(model)]),
            lambda _, sizes: EffectMessage.WARMS_UP(scanner_creep_mm=math.hypot(*sizes)),
            trials=float(len(REST)),
        ),
    )


def _waves(model: ScanModel) -> list[FloatArray]:
    """Return waves in time, (views,) each, whose sizes fall with their number as in a random walk."""
    at = math.pi * (progress(model) + 0.5)
    waves = (np.cos(number * at) / number for number in range(1, min(WAVES, len(at) // 3) + 1))
    return [wave - wave.mean() for wave in waves]


def _span_mm(model: ScanModel, sizes: FloatArray) -> float:
    """Return twice the largest distance from the mean of a motion with these sizes, x and y of each wave."""
    return 2.0 * float(np.hypot(*(sizes.reshape(-1, 2).T @ _waves(model))).max())


def _shows(move_mm: Callable[[ScanModel, FloatArray], float]) -> Callable[[ScanModel, FloatArray], bool]:
    """Return whether an effect moves the drawing's outline by more than the drawing's precision."""
    return lambda model, sizes: move_mm(model, sizes) > model.drawing.precision_mm


def _root(square: float) -> float:
    return math.sqrt(max(float(square), 0.0))


# The phantom differs from its drawing by an affine change: wet across the grain, or not square to the axis.
DEFORMATION = Effect(
    Adjustment.DEFORMATION,
    _terms(Term.ASPECT, Term.SHEAR),
    lambda _, sizes: EffectMessage.DEFORMATION(
        longer_percent=100.0 * float(sizes[0]), sheared_percent=100.0 * float(sizes[1])
    ),
    _shows(lambda model, sizes: 0.5 * math.hypot(*sizes) * model.drawing.radius_mm),
)
# The angles run too fast or too slowly.
PACE = Effect(Adjustment.PACE, lambda model: of_angle([progress(model)]), _pace)

# Phantom or scanner move in any other way than those below: as rare as a motion that comes to rest.
UNSTEADY_MOTIONS = (
    Effect(
        Adjustment.CREEP,
        lambda model: of_position(_waves(model)),
        lambda model, sizes: EffectMessage.PHANTOM_UNSTEADY(unsteady_mm=_span_mm(model, sizes)),
        trials=3.0,
    ),
    Effect(
        Adjustment.CREEP,
        lambda model: in_the_laboratory(model, _waves(model)),
        lambda model, sizes: EffectMessage.SCANNER_UNSTEADY(scanner_creep_mm=_span_mm(model, sizes)),
        trials=3.0,
    ),
)

EFFECTS: tuple[Effect, ...] = (
    # The measured line integral is p + c p^2 + d p^3.
    Effect(Adjustment.BEAM_HARDENING, _terms(Term.HARDENING, Term.HARDENING_CUBIC), _hardening),
    # The phantom scatters radiation into the cells: from around, and from the whole view.
    Effect(Adjustment.SCATTERED_RADIATION, _terms(Term.SCATTER, Term.SCATTER_WIDE, counts=True), _scattered_radiation),
    # The focal spot and the scintillator blur along the detector: a Gaussian.
    Effect(
        Adjustment.BLUR,
        _terms(Term.BLUR),
        lambda _, sizes: EffectMessage.BLUR(blur_cells=_root(sizes[0])),
        lambda _, sizes: bool(sizes[0] > 0.0),
    ),
    # A view still shows some of the view before.
    Effect(
        Adjustment.LAG,
        _terms(Term.LAG, counts=True),
        lambda _, sizes: EffectMessage.LAG(lag_percent=100.0 * float(sizes[0])),
    ),
    # The phantom turns while a view is exposed.
    Effect(
        Adjustment.ROTATION_DURING_EXPOSURE,
        _terms(Term.EXPOSURE),
        lambda _, sizes: EffectMessage.EXPOSURE(turn_percent=100.0 * _root(sizes[0])),
        lambda _, sizes: bool(sizes[0] > 0.0),
    ),
    # The detector's response has changed since the flat fields were taken: by a slope and a curvature across it.
    Effect(
        Adjustment.FLAT_FIELD,
        _terms(Term.SLOPE, Term.CURVATURE),
        lambda _, sizes: EffectMessage.FLAT_FIELD(
            slope_percent=100.0 * float(sizes[0]), ends_percent=25.0 * float(sizes[1])
        ),
    ),
    # The density slopes over the wood, as with moisture.
    Effect(
        Adjustment.DENSITY_GRADIENT,
        _terms(Term.GRADIENT_X, Term.GRADIENT_Y),
        # A slope of 1 / mm is 10 000 % in 100 mm.
        lambda _, sizes: EffectMessage.DENSITY_GRADIENT(slope_percent=1e4 * math.hypot(*sizes)),
    ),
    DEFORMATION,
    # Wear or the saw has rounded the corners.
    Effect(
        Adjustment.CORNERS,
        _terms(Term.CORNERS),
        lambda _, sizes: EffectMessage.CORNERS(radius_mm=_root(sizes[0])),
        _shows(lambda _, sizes: _root(sizes[0])),
    ),
    PACE,
    # The phantom moves steadily during the scan.
    Effect(
        Adjustment.CREEP,
        lambda model: of_position([progress(model)]),
        lambda _, sizes: EffectMessage.PHANTOM_CREEP(creep_mm=math.hypot(*sizes)),
    ),
    # Source, turntable or detector move steadily, as when the scanner warms up.
    Effect(
        Adjustment.CREEP,
        lambda model: in_the_laboratory(model, [progress(model)]),
        lambda _, sizes: EffectMessage.SCANNER_CREEP(scanner_creep_mm=math.hypot(*sizes)),
    ),
    _encoder(EffectMessage.ENCODER_LOW, (1, 2)),
    _encoder(EffectMessage.ENCODER_HIGH, (3, 4)),
    # The turntable's axis wobbles.
    *(_wobble(order, times) for order, times in _USUAL.items()),
    *(_wobble(order, times, 2.0 * len(_RARE)) for order, times in _RARE.items()),
    *(effect for share in REST for effect in _coming_to_rest(share)),
    *UNSTEADY_MOTIONS,
)


def _skin(term: Term) -> Effect:
    """Return the effect of wood that is wetter or drier within some depth of its surface."""
    depth_mm = SKIN_DEPTHS_MM[term]
    return Effect(
        Adjustment.SURFACE_DENSITY,
        lambda model: (Column.of(term),) if model.has_skin(term) else (),
        lambda _, sizes: EffectMessage.SURFACE_DENSITY(
            depth_mm=depth_mm,
            change_percent=100.0 * abs(float(sizes[0])),
            density="denser" if sizes[0] > 0.0 else "less dense",
        ),
        # A skin changes the rays as an outline does that is off by its depth times its share.
        possible=_shows(lambda _, sizes: depth_mm * abs(sizes[0])),
    )


# Effects of real wood, which are looked for where the ones above leave something: their derivatives cost more.
OF_WOOD: tuple[Effect, ...] = (
    Effect(
        Adjustment.BOW,
        _terms(Term.BOW_X, Term.BOW_Y),
        lambda _, sizes: EffectMessage.BOW(bow_mm=math.hypot(*sizes)),
        _shows(lambda _, sizes: math.hypot(*sizes)),
    ),
    # A plank that is bent is also longer along the outside of the bend than along the inside.
    Effect(
        Adjustment.BOW,
        _terms(Term.TAPER_X, Term.TAPER_Y),
        lambda _, sizes: EffectMessage.TAPER(taper_mm=math.hypot(*sizes)),
        _shows(lambda _, sizes: math.hypot(*sizes)),
    ),
    *map(_skin, SKIN_DEPTHS_MM),
)


def progress(model: ScanModel) -> FloatArray:
    """Return a line from -1/2 at the first view to 1/2 at the last, (views,)."""
    return np.linspace(-0.5, 0.5, len(model.data.angles_rad))


def harmonics(model: ScanModel, order: float) -> tuple[FloatArray, FloatArray]:
    """Compute cosine and sine of a multiple of the turn since the first view, (views,) each."""
    angles = order * (model.data.angles_rad - model.data.angles_rad[0])
    return np.cos(angles), np.sin(angles)


def of_angle(shapes: Sequence[FloatArray]) -> tuple[Column, ...]:
    """Return a column for each shape (views,): the turn."""
    return tuple(Column(((Term.PSI, shape),)) for shape in shapes)


def of_position(shapes: Sequence[FloatArray]) -> tuple[Column, ...]:
    """Return two columns for each shape (views,): the phantom's position in x, and in y."""
    return tuple(Column(((term, shape),)) for shape in shapes for term in (Term.T_X, Term.T_Y))


def in_the_laboratory(model: ScanModel, shapes: Sequence[FloatArray]) -> tuple[Column, ...]:
    """Return two columns for each shape (views,): a move across the beam, and a move along the beam."""
    phi = model.data.angles_rad + model.x[FitParameter.PSI]
    cosine, sine = np.cos(phi), np.sin(phi)
    columns = []
    for shape in shapes:
        columns.append(Column(((Term.T_X, shape * cosine), (Term.T_Y, shape * sine))))
        columns.append(Column(((Term.T_X, -shape * sine), (Term.T_Y, shape * cosine))))
    return tuple(columns)


def largest_move(sizes: FloatArray) -> float:
    """Compute the amplitude, mm, of a harmonic in the laboratory from sizes (across, along) of cosine, then sine."""
    cosine, sine = np.asarray(sizes[:2]), np.asarray(sizes[2:4])
    return float(math.sqrt(max(np.linalg.eigvalsh(np.outer(cosine, cosine) + np.outer(sine, sine)).max(), 0.0)))


def places_of_cells(cells: DetectorCells) -> Iterator[Effect]:
    """Yield the effects by which a detector's cells lie elsewhere, starting from these places."""
    bent = 0.0 if cells.arc_radius_mm is None else 1.0 / cells.arc_radius_mm
    yield Effect(
        Adjustment.CELL_PLACES,
        lambda _: (Column.of(arc_term()),),
        lambda _, sizes: EffectMessage.ARC(radius_mm=1.0 / (bent + float(sizes[0]))),
        lambda model, sizes: (
            # A detector is no more than half a circle.
            0.0 <= bent + sizes[0] < math.pi / (cells.count * cells.width_mm)
            and is_beyond_drawing(model, sizes[0] * model.rows_of_cells([arc_term()])[0])
        ),
    )
    known = np.pad(cells.waves_mm, (0, MOST_WAVES - len(cells.waves_mm)))

    def shifts_mm(sizes: FloatArray) -> FloatArray:
        return waves(tuple(known + sizes), np.arange(cells.count), cells.count)

    yield Effect(
        Adjustment.CELL_PLACES,
        lambda _: tuple(map(Column.of, wave_terms())),
        lambda _, sizes: EffectMessage.UNEVEN_CELLS(uneven_mm=math.sqrt(float((shifts_mm(sizes) ** 2).mean()))),
        lambda model, sizes: (
            # The cells stay in their order.
            bool(np.diff(shifts_mm(sizes)).min() > -cells.width_mm) and is_beyond_drawing(model, shifts_mm(sizes))
        ),
    )


def is_beyond_drawing(model: ScanModel, shifts_mm: FloatArray) -> bool:
    """Return whether cells are off by more than the shadow of a drawing that is off by a share of its precision."""
    return float((shifts_mm**2).mean()) > (STAYS * model.frame.magnification * model.drawing.precision_mm) ** 2
