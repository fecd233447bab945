"""The phantom's body in the mill: worn, wet, grown of wood, with screws, and its motion from view to view."""

import math
from dataclasses import dataclass, replace

import numpy as np
import scipy

from sawmill_tomography.geometry.geometry import TAU, FloatArray
from sawmill_tomography.phantoms.phantom import Disc, Phantom, PhantomError, Polygon, Shape, cornered
from sawmill_vocabulary.physics import MotionEffects, WoodEffects

# Number of chords of a rounded corner; mm between the points of a sawn side, and their correlation length in mm.
ARC_CHORDS, SAW_STEP_MM, SAW_LENGTH_MM = 12, 3.0, 6.0
LATE_WOOD = 0.375
KNOT_RADII_MM = (5.0, 12.0)
# Width of wood around a screw's or knot's middle, and the number of random points tried for it.
MARGIN_MM, DRAWS = 10.0, 10_000
# Number of corners of a circle that has become an ellipse; the polygon keeps the circle's area.
CIRCLE_CORNERS = 360


@dataclass(frozen=True, eq=False)
class WornBody:
    """The body that the rays cross."""

    wood: Phantom  # shapes with densities in attenuation per mm
    grain: FloatArray  # (discs, 4)
    metal: FloatArray  # (discs, 4): screws, rows (x, y, radius, attenuation per mm)
    slope_per_mm: FloatArray  # (2,): relative growth of the density along x and y


def stand(phantom: Phantom, effects: WoodEffects, rng: np.random.Generator) -> WornBody:
    """Make the body of a drawing; the positions of rings, knots and screws are random."""
    rounded = [_rounded(shape, effects.corner_radius_mm) for shape in phantom.shapes]
    sawn = [_sawn(shape, effects.roughness_mm, rng) for shape in rounded]
    wood = replace(phantom, shapes=tuple(_mapped(shape, _affine(effects)) for shape in sawn))
    rings = _rings(wood, effects, rng) if effects.ring_contrast else []
    knots = [
        (*point_inside(wood, rng), rng.uniform(*KNOT_RADII_MM), effects.knot_contrast) for _ in range(effects.knots)
    ]
    screws = [
        (*point_inside(wood, rng), 0.5 * effects.screw_diameter_mm, effects.steel_per_mm) for _ in range(effects.screws)
    ]
    slope = effects.density_slope_percent / 1e4 * direction(effects.density_slope_towards_deg)
    return WornBody(wood, _rows(rings + knots), _rows(screws), slope)


def point_inside(wood: Phantom, rng: np.random.Generator) -> tuple[float, float]:
    """Draw a random point with wood all round it."""
    around = MARGIN_MM * np.stack([np.cos(TAU * np.arange(8) / 8), np.sin(TAU * np.arange(8) / 8)], -1)
    for _ in range(DRAWS):
        point = rng.uniform(-wood.radius_mm, wood.radius_mm, 2)
        places = (point, *(point + around))
        if all(sum(shape.density for shape in wood.shapes if _holds(shape, x, y)) > 0.0 for x, y in places):
            return float(point[0]), float(point[1])
    raise PhantomError(
        f"the phantom {wood.name!r} has no place for a knot or a screw with {MARGIN_MM:g} mm of wood around it"
    )


def _rows(discs: list[tuple[float, float, float, float]]) -> FloatArray:
    return np.array(discs, np.float64).reshape(-1, 4)


def _affine(effects: WoodEffects) -> FloatArray:
    """Return the map of the drawing by size, aspect, shear and a tilted plane, (2, 2)."""
    half = 0.5 * effects.aspect_percent / 100.0
    change = np.array([[1.0 + half, effects.shear_percent / 100.0], [0.0, 1.0 - half]])
    along = direction(effects.plane_tilt_towards_deg)
    tilted = np.eye(2) + (1.0 / math.cos(math.radians(effects.plane_tilt_deg)) - 1.0) * np.outer(along, along)
    return np.asarray((1.0 + effects.size_percent / 100.0) * tilted @ change)


def _mapped(shape: Shape, change: FloatArray) -> Shape:
    """Map a shape; a disc remains a disc under a change of size alone."""
    if isinstance(shape, Disc) and np.allclose(change, change[0, 0] * np.eye(2), rtol=0.0, atol=1e-12):
        x, y = change @ shape.center_mm
        return replace(shape, center_mm=(float(x), float(y)), radius_mm=shape.radius_mm * float(change[0, 0]))
    polygon = cornered(shape, CIRCLE_CORNERS)
    return _polygon(polygon, np.array(polygon.vertices_mm) @ change.T)


def _polygon(shape: Polygon, corners: FloatArray) -> Polygon:
    return replace(shape, vertices_mm=tuple((float(x), float(y)) for x, y in corners))


def _rounded(shape: Shape, radius_mm: float) -> Shape:
    """Round a polygon's corners by arcs, inward corners too, each within 0.45 of its sides."""
    if isinstance(shape, Disc) or radius_mm == 0.0:
        return shape
    corners = np.array(shape.vertices_mm)
    befores, afters = np.roll(corners, 1, axis=0), np.roll(corners, -1, axis=0)
    return _polygon(
        shape, np.concatenate([_arc(*three, radius_mm) for three in zip(befores, corners, afters, strict=True)])
    )


def _arc(before: FloatArray, corner: FloatArray, after: FloatArray, radius_mm: float) -> FloatArray:
    """Return the points that replace a corner, (chords + 1, 2)."""
    to_before, to_after = before - corner, after - corner
    a, b = to_before / np.hypot(*to_before), to_after / np.hypot(*to_after)
    half = 0.5 * math.acos(float(np.clip(a @ b, -1.0, 1.0)))
    if half > 0.499 * math.pi:  # straight on
        return corner[None]
    radius = min(radius_mm, 0.45 * math.tan(half) * min(np.hypot(*to_before), np.hypot(*to_after)))
    centre = corner + radius / math.sin(half) * (a + b) / np.hypot(*(a + b))
    start, stop = corner + radius / math.tan(half) * a - centre, corner + radius / math.tan(half) * b - centre
    first = math.atan2(start[1], start[0])
    bends = first + math.remainder(math.atan2(stop[1], stop[0]) - first, TAU) * np.linspace(0.0, 1.0, ARC_CHORDS + 1)
    return np.asarray(centre + radius * np.stack([np.cos(bends), np.sin(bends)], -1))


def _sawn(shape: Shape, roughness_mm: float, rng: np.random.Generator) -> Shape:
    """Roughen a polygon's sides; its corners stay in place."""
    if isinstance(shape, Disc) or roughness_mm == 0.0:
        return shape
    corners = np.array(shape.vertices_mm)
    sides = zip(corners, np.roll(corners, -1, axis=0), strict=True)
    return _polygon(shape, np.concatenate([_side(start, stop, roughness_mm, rng) for start, stop in sides]))


def _side(start: FloatArray, stop: FloatArray, roughness_mm: float, rng: np.random.Generator) -> FloatArray:
    """Return the points of a side from its first corner on, without the last one."""
    along = stop - start
    count = max(round(float(np.hypot(*along)) / SAW_STEP_MM), 1)
    width = SAW_LENGTH_MM / SAW_STEP_MM
    spread = 1.0 / math.sqrt(2.0 * math.sqrt(math.pi) * width)  # standard deviation of smoothed white noise
    noise = scipy.ndimage.gaussian_filter1d(rng.standard_normal(count), width, mode="wrap") * roughness_mm / spread
    noise[0] = 0.0
    normal = np.array([-along[1], along[0]]) / np.hypot(*along)
    return np.asarray(start + np.arange(count)[:, None] / count * along + noise[:, None] * normal)


def _rings(wood: Phantom, effects: WoodEffects, rng: np.random.Generator) -> list[tuple[float, float, float, float]]:
    """Make late wood in rings about a pith in or near the board: a disc and, just inside it, its opposite."""
    distance, towards = rng.uniform(0.0, wood.radius_mm), rng.uniform(0.0, TAU)
    x, y = float(distance * math.cos(towards)), float(distance * math.sin(towards))
    spacing = effects.ring_spacing_mm
    radii = np.arange(spacing, distance + wood.radius_mm + spacing, spacing).tolist()
    outer = [(x, y, radius, effects.ring_contrast) for radius in radii]
    return outer + [(x, y, radius - LATE_WOOD * spacing, -effects.ring_contrast) for radius in radii]


def _holds(shape: Shape, x: float, y: float) -> bool:
    """Return whether a point lies inside, even-odd for polygons."""
    if isinstance(shape, Disc):
        return math.hypot(x - shape.center_mm[0], y - shape.center_mm[1]) < shape.radius_mm
    corners = np.array(shape.vertices_mm)
    (xa, ya), (xb, yb) = corners.T, np.roll(corners, -1, axis=0).T
    spans = (ya > y) != (yb > y)
    crossings = xa[spans] + (y - ya[spans]) * (xb[spans] - xa[spans]) / (yb[spans] - ya[spans])
    return bool(np.count_nonzero(crossings > x) % 2)


def direction(angle_deg: float) -> FloatArray:
    """Return the unit vector (2,) at this angle."""
    return np.array([math.cos(math.radians(angle_deg)), math.sin(math.radians(angle_deg))])


@dataclass(frozen=True, eq=False)
class Motion:
    """True angle of each view, and the phantom's displacement in it."""

    angles_rad: FloatArray  # (views,): True angles in the scanner's sense of rotation
    turn_rad: FloatArray  # (views,): turn of the phantom in the image, about the rotation centre
    offset_mm: FloatArray  # (views, 2): displacement in the image, and in the hall: across the beam and along it
    hall_mm: FloatArray  # (views, 2)
    slip_view: int | None  # the first view after the slip


def move(angles_rad: FloatArray, effects: MotionEffects, rng: np.random.Generator) -> Motion:
    """Draw the motion behind view angles that the scanner reports, (views,) in its sense of rotation."""
    views = angles_rad.size
    encoder = math.radians(effects.encoder_deg) * np.cos(angles_rad - math.radians(effects.encoder_phase_deg))
    jitter = math.radians(effects.angle_jitter_deg) * rng.standard_normal(views)
    turned = angles_rad + effects.pace_percent / 100.0 * (angles_rad - angles_rad[0]) + encoder + jitter
    slip_view = round(effects.slip_at * views) if effects.slip_mm or effects.slip_turn_deg else None
    slipped = (np.arange(views) >= (views if slip_view is None else slip_view)).astype(np.float64)
    slip = effects.slip_mm * slipped[:, None] * direction(effects.slip_towards_deg)
    creep = effects.creep_mm * np.linspace(0.0, 1.0, views)[:, None] * direction(effects.creep_towards_deg)
    wave = turned - math.radians(effects.wobble_phase_deg)
    swing = effects.wobble_once_mm * np.cos(wave) + effects.wobble_twice_mm * np.cos(2.0 * wave)
    hall = swing[:, None] * direction(effects.wobble_towards_deg)
    turn = math.radians(effects.slip_turn_deg) * slipped
    return Motion(turned, np.asarray(turn), np.asarray(slip + creep), hall, slip_view)
