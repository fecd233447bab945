"""Tracing of a phantom's picture: its outlines in mm, sub-pixel."""

import math

import numpy as np
from numpy.typing import NDArray

from sawmill_tomography.geometry.geometry import FloatArray
from sawmill_tomography.phantoms.phantom import Disc, Phantom, PhantomError, Polygon, Shape
from sawmill_vocabulary import MOST_CORNERS, STANDARD_SIZE_TOLERANCE

# In pixels: a contour this close to a circle is a circle; a polygon may cut corners by this before its sides are
# fitted.
CIRCLE_RMS = 0.4
CORNER_CUT = 1.5
# Corners of the outline within this many pixels are left out when a side is fitted: contouring rounds them.
NEAR_CORNER = 3.0
LEAST_AREA = 25.0
# A narrower picture does not show a polygon of 0.01 mm², the smallest that a drawing may have.
LEAST_WIDTH_MM = 0.1
MOST_SHAPES = 200
# Sides of pixels between bright and dark: one point of an outline each, and some 250 bytes while they are joined.
MOST_EDGES = 1_000_000
ROWS_AT_ONCE = 256


def trace(
    picture: NDArray[np.floating], width_mm: float, *, name: str, size_tolerance: float = STANDARD_SIZE_TOLERANCE
) -> Phantom:
    """Outline the bright parts of a drawing.

    Parameters
    ----------
    picture : (rows, columns) float
        Grey values; bright is wood. A row is +x, a column is +y, the centre is the origin.
    width_mm : float
        Width of the picture, along its columns, in mm.
    size_tolerance : float
        Relative standard uncertainty of the drawn size; the picture's pixels may make it larger.

    Returns
    -------
    Phantom
        Polygons and discs; a dark region inside a bright one is a hole.

    Raises
    ------
    PhantomError
        If the picture shows no outline, or far too many outlines, or an outline of too many corners.
    """
    from skimage.measure import find_contours  # noqa: PLC0415 - takes a second to import, for pictures only

    if picture.ndim != 2 or min(picture.shape) < 8:
        raise PhantomError(f"the picture has shape {picture.shape}: give a grey picture of at least 8 x 8 pixels")
    if not (math.isfinite(width_mm) and width_mm >= LEAST_WIDTH_MM):
        raise PhantomError(
            f"the picture's width is {width_mm:g} mm: give the width of the whole picture, at least {LEAST_WIDTH_MM:g} "
            "mm"
        )
    low, high = float(picture.min()), float(picture.max())
    if not high > low:
        raise PhantomError("the picture is of one grey throughout: the phantom must be brighter than its surroundings")
    pixel = width_mm / picture.shape[1]
    centre = 0.5 * (np.array(picture.shape) - 1.0)
    level = 0.5 * (low + high)
    _check_edges(picture, level)
    first, bright = _bright_part(picture, level, low)
    outlines = [contour[:-1] + first for contour in find_contours(bright, level)]
    outlines = [outline for outline in outlines if abs(_area(outline)) >= LEAST_AREA]
    if not outlines:
        raise PhantomError("the picture shows no outline of at least 25 pixels")
    if len(outlines) > MOST_SHAPES:
        raise PhantomError(f"the picture shows {len(outlines)} outlines, more than {MOST_SHAPES}: give a clean drawing")
    # find_contours keeps the bright side on one hand, so the sign of the area distinguishes wood from hole.
    shapes = [_shape((outline - centre) * pixel, pixel, 1.0 if _area(outline) < 0.0 else -1.0) for outline in outlines]
    if not any(shape.density > 0.0 for shape in shapes):
        raise PhantomError("the picture shows holes only: the phantom must be brighter than its surroundings")
    # Two sides, each somewhere in its pixel, leave pixel / sqrt(6) of the size open.
    extent = float(np.ptp(np.concatenate(Phantom("outlines", tuple(shapes)).outlines()), axis=0).mean())
    return Phantom(name, tuple(shapes), max(size_tolerance, pixel / math.sqrt(6.0) / extent), pixel / math.sqrt(2.0))


def _bright_part(
    picture: NDArray[np.floating], level: float, low: float
) -> tuple[NDArray[np.intp], NDArray[np.floating]]:
    """Cut out the bright part with a dark pixel around it, and its first index: all outlines, in less memory."""
    rows, columns = np.zeros(picture.shape[0], bool), np.zeros(picture.shape[1], bool)
    for start in range(0, len(picture), ROWS_AT_ONCE):
        bright = picture[start : start + ROWS_AT_ONCE] > level
        rows[start : start + ROWS_AT_ONCE] = bright.any(axis=1)
        columns |= bright.any(axis=0)
    ends = np.array([np.flatnonzero(along)[[0, -1]] for along in (rows, columns)])
    part = picture[slice(max(ends[0, 0] - 1, 0), ends[0, 1] + 2), slice(max(ends[1, 0] - 1, 0), ends[1, 1] + 2)]
    padding = [(int(ends[axis, 0] == 0), int(ends[axis, 1] == picture.shape[axis] - 1)) for axis in (0, 1)]
    return ends[:, 0] - 1, np.pad(part, padding, constant_values=low) if np.any(padding) else part


def _check_edges(picture: NDArray[np.floating], level: float) -> None:
    """Refuse a picture of more edges than outlines can be made of, before outlines are made."""
    edges, above = 0, np.zeros((1, picture.shape[1]), bool)
    for start in range(0, len(picture), ROWS_AT_ONCE):
        bright = np.concatenate([above, picture[start : start + ROWS_AT_ONCE] > level])
        edges += int((bright[1:] != bright[:-1]).sum() + (bright[1:, 1:] != bright[1:, :-1]).sum())
        above = bright[-1:]
    if edges > MOST_EDGES:
        raise PhantomError(
            f"the picture has edges along {edges} pixel sides; at most {MOST_EDGES} are traced: give a clean drawing, "
            "without texture or noise"
        )


def _area(outline: FloatArray) -> float:
    x, y = outline[:, 0], outline[:, 1]
    return 0.5 * float(np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y))


def _shape(outline: FloatArray, pixel: float, density: float) -> Shape:
    centre, radius, rms = _circle(outline)
    if rms < CIRCLE_RMS * pixel and radius > 2.0 * pixel:
        return Disc(centre, radius, density)
    corners = _corners(outline, CORNER_CUT * pixel)
    return Polygon(tuple((float(x), float(y)) for x, y in _fit_sides(outline, corners, NEAR_CORNER * pixel)), density)


def _circle(points: FloatArray) -> tuple[tuple[float, float], float, float]:
    """Fit a least-squares circle (Kasa 1976): centre, radius, RMS distance."""
    system = np.column_stack([2.0 * points, np.ones(len(points))])
    solution = np.linalg.lstsq(system, (points**2).sum(axis=1), rcond=None)[0]
    cx, cy = float(solution[0]), float(solution[1])
    distance = np.hypot(points[:, 0] - cx, points[:, 1] - cy)
    radius = float(distance.mean())
    return (cx, cy), radius, float(np.sqrt(np.mean((distance - radius) ** 2)))


def _corners(outline: FloatArray, tolerance: float) -> NDArray[np.intp]:
    """Find the indices of an outline's corners from the farthest point on (Douglas and Peucker 1973)."""
    first = int(np.argmax(((outline - outline.mean(axis=0)) ** 2).sum(axis=1)))
    x, y = np.concatenate([outline[first:], outline[: first + 1]]).T.copy()
    corners, sides = [0], [(0, len(outline))]
    while sides:
        start, stop = sides.pop()
        squares = _squared_distances(x[start : stop + 1], y[start : stop + 1])
        farthest = start + int(np.argmax(squares))
        if squares[farthest - start] <= tolerance**2:
            continue
        corners.append(farthest)
        if len(corners) > MOST_CORNERS:
            raise PhantomError(
                f"an outline of the picture has more than {MOST_CORNERS} corners, which is the most that a polygon may "
                "have: give a clean drawing, without texture or noise"
            )
        # The shorter side first: this soon finds too many corners.
        sides += sorted([(start, farthest), (farthest, stop)], key=lambda side: side[0] - side[1])
    return (np.sort(corners) + first) % len(outline)


def _squared_distances(x: FloatArray, y: FloatArray) -> FloatArray:
    """Return squared distances of points from the line segment between the first and the last point."""
    across, up = x[-1] - x[0], y[-1] - y[0]
    x, y = x - x[0], y - y[0]
    share = np.clip((x * across + y * up) / max(across**2 + up**2, np.finfo(float).tiny), 0.0, 1.0)
    return np.asarray((x - share * across) ** 2 + (y - share * up) ** 2)


def _fit_sides(outline: FloatArray, corners: NDArray[np.intp], near: float) -> FloatArray:
    """Return the corners where total-least-squares lines through the outline's sides meet."""
    count = len(corners)
    if count < 3:
        raise PhantomError("an outline of the picture is too thin to be a body")
    lines = [_side(outline, corners[i], corners[(i + 1) % count], near) for i in range(count)]
    fitted = []
    for i in range(count):
        (p, d), (q, e) = lines[i - 1], lines[i]
        across = d[0] * e[1] - d[1] * e[0]
        corner = outline[corners[i]]
        if abs(across) > math.sin(math.radians(5.0)):
            meeting = p + (((q[0] - p[0]) * e[1] - (q[1] - p[1]) * e[0]) / across) * d
            # Two short sides of a curve may meet far away: such a corner keeps its place in the outline.
            corner = meeting if np.hypot(*(meeting - corner)) < 2.0 * near else corner
        fitted.append(corner)
    return np.array(fitted)


def _side(outline: FloatArray, start: int, stop: int, near: float) -> tuple[FloatArray, FloatArray]:
    """Return a point and a unit direction of the line through one side."""
    count = len(outline)
    points = outline[(start + np.arange((stop - start) % count + 1)) % count]
    far = (np.hypot(*(points - points[0]).T) > near) & (np.hypot(*(points - points[-1]).T) > near)
    points = points[far] if far.sum() >= 3 else points[[0, -1]]
    middle = points.mean(axis=0)
    return middle, np.linalg.svd(points - middle)[2][0]
