"""Effects that may be fitted with the geometry: one table of what each adds to the model, reports and advises.

An effect is fitted where the scan shows it (`selection.py`). The effect of a slip, which depends on the view, is in
`slip.py`.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from sawmill_tomography.calibration.faults.motion import (
    harmonics,
    in_the_laboratory,
    largest_move,
    of_angle,
    of_position,
    progress,
)
from sawmill_tomography.calibration.joint_fit.normal_equations import Column
from sawmill_tomography.calibration.joint_fit.scan_model import SKIN_DEPTHS_MM, ScanModel, Term
from sawmill_tomography.geometry.geometry import FloatArray
from sawmill_vocabulary import Adjustment

# The share of samples above which a shadow is the deepest.
DEEPEST = 0.98
# With fewer views a step is so large that two points do not represent an exposure.
FEWEST_VIEWS = 60
# A skin whose density differs by a larger share is something else.
LARGEST_SKIN = 0.5
STRAIGHT = "use straight, dry wood for the phantom, or draw it as it is"
_TIMES = {1: "once", 2: "twice", 3: "three times", 4: "four times"}


@dataclass(frozen=True)
class Effect:
    """An effect in a scan that the plain model does not have.

    Attributes
    ----------
    adjustment : Adjustment
        The option that switches the effect off.
    columns : callable
        Unknowns of the effect for a model; none where such a scan cannot show the effect.
    sentence : callable
        Reported sentence, from the model that has the effect and the sizes of the effect's columns.
    remedy : str
        Advice to the user, where something should be done.
    possible : callable
        True for a model and sizes of the columns that such an effect may have.
    """

    adjustment: Adjustment
    columns: Callable[[ScanModel], tuple[Column, ...]]
    sentence: Callable[[ScanModel, FloatArray], str]
    remedy: str = ""
    possible: Callable[[ScanModel, FloatArray], bool] = lambda _, __: True


def _terms(*chosen: Term, counts: bool = False) -> Callable[[ScanModel], tuple[Column, ...]]:
    """Return columns with one term each; none where intensities are needed (`counts`) and the scan has none."""

    def columns(model: ScanModel) -> tuple[Column, ...]:
        if counts and not model.from_counts:
            return ()
        return tuple(Column.of(term) for term in chosen)

    return columns


def _hardening_sentence(model: ScanModel, sizes: FloatArray) -> str:
    longest = float(model.lengths.max())
    change = sizes[0] * longest + sizes[1] * longest**2
    return f"beam hardening of {change:+.1%} on the longest path"


def _scattered_radiation_sentence(model: ScanModel, sizes: FloatArray) -> str:
    around, wide = model.halos
    deepest = model.blurred > np.quantile(model.blurred, DEEPEST)
    added = float((sizes[0] * around + sizes[1] * wide)[deepest].mean())
    if added < 0.0:
        # With the gains of the views, scatter takes up what powers of the paths leave of the hardening.
        return "scattered radiation, whose amount this scan does not tell from that of the beam hardening"
    return f"scattered radiation, which adds {added:.1%} to the intensity of the deepest shadow"


def _exposure_columns(model: ScanModel) -> tuple[Column, ...]:
    return (Column.of(Term.EXPOSURE),) if len(model.data.angles_rad) >= FEWEST_VIEWS else ()


def _pace_sentence(model: ScanModel, sizes: FloatArray) -> str:
    turned = float(model.data.angles_rad[-1] - model.data.angles_rad[0])
    pace = 1.0 + float(sizes[0]) / turned if turned else 1.0
    return f"the turntable turns {pace:.4f} times as far as the angles say"


def _encoder(orders: tuple[int, int]) -> Effect:
    """Return the effect of angles that are ahead and behind these numbers of times a turn, as with a faulty encoder."""

    def sentence(_: ScanModel, sizes: FloatArray) -> str:
        first, second = np.rad2deg([math.hypot(*sizes[:2]), math.hypot(*sizes[2:])])
        often = [_TIMES[order] for order in orders]
        return (
            f"the angles are ahead and behind {often[0]} a turn, by {first:.2g} degrees, and {often[1]} a turn, by "
            f"{second:.2g}"
        )

    return Effect(
        Adjustment.ENCODER,
        lambda model: of_angle([shape for order in orders for shape in harmonics(model, order)]),
        sentence,
        "the encoder is off its axis, or the drive slips and catches: look at them",
    )


def _wobble(order: int) -> Effect:
    return Effect(
        Adjustment.WOBBLE,
        lambda model: in_the_laboratory(model, harmonics(model, order)),
        lambda _, sizes: f"the turntable wobbles {_TIMES[order]} a turn, by {largest_move(sizes):.2g} mm",
        "look at the turntable's bearing and what the phantom stands on",
    )


def _root(square: float) -> float:
    return math.sqrt(max(float(square), 0.0))


# The phantom differs from its drawing by an affine change: wet across the grain, or not square to the axis.
DEFORMATION = Effect(
    Adjustment.DEFORMATION,
    _terms(Term.ASPECT, Term.SHEAR),
    lambda _, sizes: (
        f"the phantom is longer in x than in y against its drawing by {sizes[0]:+.2%}, and sheared by {sizes[1]:+.2%}"
    ),
    "measure both sides of the phantom, and check that it stands square to the axis",
)
# The angles run too fast or too slowly.
PACE = Effect(
    Adjustment.PACE,
    lambda model: of_angle([progress(model)]),
    _pace_sentence,
    "check the angles' step, the encoder's counts in a turn, and the clamps",
)
# The turntable's axis wobbles, as with a worn bearing.
WOBBLES = tuple(_wobble(order) for order in _TIMES)

EFFECTS: tuple[Effect, ...] = (
    # The measured line integral is p + c p^2 + d p^3.
    Effect(Adjustment.BEAM_HARDENING, _terms(Term.HARDENING, Term.HARDENING_CUBIC), _hardening_sentence),
    # The phantom scatters radiation into the cells: from around, and from the whole view.
    Effect(
        Adjustment.SCATTERED_RADIATION,
        _terms(Term.SCATTER, Term.SCATTER_WIDE, counts=True),
        _scattered_radiation_sentence,
    ),
    # The focal spot and the scintillator blur along the detector: a Gaussian.
    Effect(
        Adjustment.BLUR,
        _terms(Term.BLUR),
        lambda _, sizes: f"a blur of {_root(sizes[0]):.2f} detector cells (standard deviation)",
    ),
    # A view still shows some of the view before.
    Effect(
        Adjustment.LAG,
        _terms(Term.LAG, counts=True),
        lambda _, sizes: f"a lag of the detector, of {sizes[0]:.1%} of the view before",
    ),
    # The phantom turns while a view is exposed.
    Effect(
        Adjustment.ROTATION_DURING_EXPOSURE,
        _exposure_columns,
        lambda _, sizes: f"the phantom turns by {_root(sizes[0]):.0%} of a step while a view is exposed",
    ),
    # The detector's response has changed since the flat fields were taken: by a slope and a curvature across it.
    Effect(
        Adjustment.FLAT_FIELD,
        _terms(Term.SLOPE, Term.CURVATURE),
        lambda _, sizes: (
            f"the flat field has changed across the detector, by {sizes[0]:+.2%} from end to end and "
            f"{0.25 * sizes[1]:+.2%} at both ends"
        ),
        "take the flat fields anew, right before the scan",
    ),
    # The density slopes over the wood, as with moisture.
    Effect(
        Adjustment.DENSITY_GRADIENT,
        _terms(Term.GRADIENT_X, Term.GRADIENT_Y),
        lambda _, sizes: f"the wood's density slopes by {100.0 * math.hypot(*sizes):.1%} in 100 mm",
    ),
    DEFORMATION,
    # Wear or the saw has rounded the corners.
    Effect(
        Adjustment.CORNERS,
        _terms(Term.CORNERS),
        lambda _, sizes: f"corners rounded by {_root(sizes[0]):.1f} mm (radius)",
    ),
    PACE,
    # The phantom moves steadily during the scan.
    Effect(
        Adjustment.CREEP,
        lambda model: of_position([progress(model)]),
        lambda _, sizes: f"the phantom creeps by {math.hypot(*sizes):.2g} mm over the scan",
        "fasten the phantom on the turntable",
    ),
    # Source, turntable or detector move steadily, as when the scanner warms up.
    Effect(
        Adjustment.CREEP,
        lambda model: in_the_laboratory(model, [progress(model)]),
        lambda _, sizes: f"source, turntable or detector creep by {math.hypot(*sizes):.2g} mm over the scan",
        "let the scanner warm up, and look at what carries source and detector",
    ),
    _encoder((1, 2)),
    _encoder((3, 4)),
    *WOBBLES,
)


def _skin(term: Term) -> Effect:
    """Return the effect of wood that is wetter or drier within some depth of its surface."""
    depth_mm = SKIN_DEPTHS_MM[term]
    return Effect(
        Adjustment.SURFACE_DENSITY,
        lambda model: (Column.of(term),) if model.has_skin(term) else (),
        lambda _, sizes: (
            f"the wood within {depth_mm:g} mm of the surface is {abs(sizes[0]):.1%} "
            f"{'denser' if sizes[0] > 0.0 else 'less dense'}"
        ),
        possible=lambda _, sizes: abs(sizes[0]) <= LARGEST_SKIN,
    )


# Effects of real wood, which are looked for where the ones above leave something: their derivatives cost more.
OF_WOOD: tuple[Effect, ...] = (
    Effect(
        Adjustment.BOW,
        _terms(Term.BOW_X, Term.BOW_Y),
        lambda _, sizes: f"the phantom is bent in its plane by {math.hypot(*sizes):.2g} mm",
        STRAIGHT,
    ),
    # A plank that is bent is also longer along the outside of the bend than along the inside.
    Effect(
        Adjustment.BOW,
        _terms(Term.TAPER_X, Term.TAPER_Y),
        lambda _, sizes: (
            "the phantom is wider at one end than its drawing and narrower at the other, by "
            f"{math.hypot(*sizes):.2g} mm at its corners"
        ),
        STRAIGHT,
    ),
    *map(_skin, SKIN_DEPTHS_MM),
)
# A body that comes nearer to the source twice a turn casts the shadow of one that is longer in one direction. Only the
# lengths of the rays in the body differ, and a gain of each view hides that.
ALIKE = (DEFORMATION, WOBBLES[1])
