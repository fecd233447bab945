"""Draw docs/pictures/geometry.svg (docs/look-up/conventions.md) and ray-error.svg (docs/understand/verdict.md).

    python docs/tools/geometry_drawing.py [FOLDER]

Every point comes from `FanBeamGeometry.vectors`, `SourceFrame` and `chord_points`: a change of a sign there changes the
drawings. x runs down and y to the right, as in every picture of the product.
"""

import math
import sys
from contextlib import AbstractContextManager
from dataclasses import replace
from pathlib import Path

import matplotlib as mpl
import numpy as np

mpl.use("agg")
import matplotlib.pyplot as plt
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy.optimize import least_squares

from sawmill_tomography.geometry.detector_shape import cell_points
from sawmill_tomography.geometry.geometry import (
    FanBeamGeometry,
    FloatArray,
    Scanner,
    SourceFrame,
    Theta,
    cell_borders_mm,
    rotate,
)
from sawmill_tomography.geometry.ray_error import chord_points, ray_error

FOLDER = Path(__file__).parents[1] / "pictures"
# Not to any scanner's scale: shifts and tilt are large, so that they can be seen.
SCANNER = Scanner(source_to_cor_mm=500.0, num_detector_pixels=14, detector_pitch_mm=40.0)
THETA = Theta(
    initial_angle_rad=math.radians(12.0),
    detector_to_cor_mm=380.0,
    source_shift_mm=130.0,
    detector_shift_mm=210.0,
    detector_tilt=0.65,
)
PHI_RAD = math.radians(10.0)
LOG_RADIUS_MM = 150.0
GREY, BLUE, RED = "#777777", "#1f5fa8", "#b03a2e"
ORIGIN = np.zeros(2)
# Turns (x, y) into places of a picture whose x runs down and whose y runs to the right, and angles likewise.
PICTURE = np.array([[0.0, -1.0], [1.0, 0.0]])
PICTURE_RAD = -0.5 * math.pi


def in_picture(points: FloatArray) -> FloatArray:
    """Return places (..., 2) in the picture of points (x, y)."""
    return points @ PICTURE


def show(axes: Axes, **limits: tuple[float, float]) -> None:
    """Show the whole drawing, or as much as `xlim` and `ylim` say, without the axes themselves."""
    axes.set(aspect="equal", **limits)
    axes.axis("off")


def line(axes: Axes, start: FloatArray, end: FloatArray, **style: object) -> None:
    """Draw a line between two points, mm."""
    axes.plot(*np.stack([start, end], -1), **{"lw": 0.8, "color": GREY, **style})


def dimension(
    axes: Axes, start: FloatArray, end: FloatArray, name: str, *, aside: float = 16.0, colour: str = BLUE
) -> None:
    """Draw a double arrow with its symbol next to the middle, `aside` mm to its left."""
    arrow = {"arrowstyle": "<->", "color": colour, "lw": 0.9, "shrinkA": 0, "shrinkB": 0}
    axes.annotate("", end, start, arrowprops=arrow)
    along = (end - start) / np.linalg.norm(end - start)
    place = 0.5 * (start + end) + aside * np.array([-along[1], along[0]])
    axes.text(*place, name, color=colour, ha="center", va="center", fontsize=10 if name.startswith("$") else 12)


def arc(axes: Axes, radius: float, low_rad: float, high_rad: float, name: str, centre: FloatArray = ORIGIN) -> None:
    """Draw an angle about a point with its symbol; the arrow's head is at the second angle."""
    angles = np.linspace(low_rad, high_rad, 40)
    points = centre + radius * np.stack([np.cos(angles), np.sin(angles)], -1)
    axes.plot(*points.T, color=RED, lw=0.9)
    axes.annotate("", points[-1], points[-3], arrowprops={"arrowstyle": "->", "color": RED, "lw": 0.9})
    middle = 0.5 * (low_rad + high_rad)
    place = centre + (radius + 24.0) * np.array([math.cos(middle), math.sin(middle)])
    axes.text(*place, name, color=RED, ha="center", va="center", fontsize=10)


def ground(axes: Axes, geometry: FanBeamGeometry, title: str) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Draw axes, log, source, rays and detector of the view; return source, detector's middle and detector's axis."""
    source, centre, axis = (in_picture(vectors[0]) for vectors in geometry.vectors())
    cells = centre + cell_borders_mm(SCANNER)[:, None] * axis
    for end in (cells[0], cells[-1]):
        line(axes, source, end, color="#dddddd")
    axes.add_patch(plt.Circle((0.0, 0.0), LOG_RADIUS_MM, facecolor="#f3e6d0", edgecolor="#c8a26b", lw=0.8, zorder=0))
    for end, name in zip(in_picture(470.0 * np.eye(2)), "xy", strict=True):
        axes.annotate("", end, ORIGIN, arrowprops={"arrowstyle": "->", "color": GREY, "lw": 0.7})
        axes.text(*(end * 1.06), name, color=GREY, ha="center", va="center")
    axes.plot(*cells.T, color="black", lw=1.6, marker="|", markersize=5)
    axes.text(*(cells[0] - 42.0 * axis), "cell 0", ha="center", va="center", fontsize=8)
    last = f"cell {SCANNER.num_detector_pixels - 1}"
    axes.text(*(cells[-1] + 42.0 * axis), last, ha="center", va="center", fontsize=8)
    for point, name, beside in ((source, "S", (6, -9)), (centre, "C", (-13, -9)), (ORIGIN, "COR", (6, -9))):
        axes.plot(*point, "o", color="black", markersize=3.5)
        axes.annotate(name, point, xytext=beside, textcoords="offset points", fontsize=9)
    axes.set_title(title, fontsize=10)
    show(axes, xlim=(-520.0, 620.0), ylim=(-520.0, 560.0))
    return source, centre, axis


def draw_theta(axes: Axes, geometry: FanBeamGeometry) -> None:
    """Draw the five numbers of theta, in the axes that are turned by phi + alpha0."""
    source, centre, axis = ground(axes, geometry, r"theta = ($\alpha_0$, $r_D$, $h_S$, $h_D$, $\alpha_D$)")
    turned = PHI_RAD + THETA.initial_angle_rad + PICTURE_RAD
    across, along = (np.array(rotate(turned, *unit)) for unit in ((1.0, 0.0), (0.0, 1.0)))
    foot_s, foot_d = -SCANNER.source_to_cor_mm * along, THETA.detector_to_cor_mm * along
    line(axes, 1.05 * foot_s, 1.25 * foot_d, ls="--")
    line(axes, ORIGIN, 400.0 * across, ls="--")
    dimension(axes, foot_s, ORIGIN, "$r_S$")
    dimension(axes, ORIGIN, foot_d, "$r_D$")
    dimension(axes, foot_s, source, "$h_S$", aside=-22.0)
    dimension(axes, centre, foot_d, "$h_D$", aside=24.0)
    line(axes, centre, centre - 260.0 * across, ls=":")
    arc(axes, 210.0, turned + math.pi, turned + math.pi + math.atan(THETA.detector_tilt), r"atan $\alpha_D$", centre)
    arc(axes, 300.0, PICTURE_RAD, turned, r"$\varphi + \alpha_0$")
    axes.annotate("", centre + 110.0 * axis, centre, arrowprops={"arrowstyle": "->", "color": BLUE, "lw": 1.4})
    axes.text(*(centre + 105.0 * axis + 24.0 * along), "a", color=BLUE)


def draw_source_frame(axes: Axes, geometry: FanBeamGeometry) -> None:
    """Draw the same view's five numbers of the source frame."""
    source, centre, axis = ground(axes, geometry, r"source frame = ($\psi$, $R$, $SDD$, $u_c$, $\tau$)")
    frame: SourceFrame = geometry.frame
    turned = PHI_RAD + frame.psi_rad + PICTURE_RAD
    across, along = (np.array(rotate(turned, *unit)) for unit in ((1.0, 0.0), (0.0, 1.0)))
    shadow = centre + frame.cor_column_mm * axis
    line(axes, source, shadow + 60.0 * along, ls="--")
    line(axes, ORIGIN, 400.0 * across, ls="--")
    line(axes, shadow, shadow - 300.0 * across, ls=":")
    dimension(axes, source, ORIGIN, "$R$", aside=-20.0)
    beside = -70.0 * across
    line(axes, source, source + beside, lw=0.5)
    line(axes, shadow, shadow + beside, lw=0.5)
    dimension(axes, source + 0.9 * beside, shadow + 0.9 * beside, "$SDD$", aside=30.0)
    over = 40.0 * np.array([-axis[1], axis[0]])
    dimension(axes, centre + over, shadow + over, "$|u_c|$", aside=26.0)
    arc(axes, 270.0, turned + math.pi, turned + math.pi + frame.tilt_rad, r"$\tau$", shadow)
    arc(axes, 300.0, PICTURE_RAD, turned, r"$\varphi + \psi$")


def draw_ray_error(axes: Axes) -> None:
    """Draw the rays of some cells by two geometries, and the distances between them inside the log.

    The other geometry is turned and scaled as the ray error has it.
    """
    scanner = replace(SCANNER, num_detector_pixels=6, detector_pitch_mm=95.0)
    true = SourceFrame(0.0, 500.0, 880.0, 10.0, 0.0)
    other = SourceFrame(0.0, 500.0, 880.0, 60.0, 0.24)
    points, cells = chord_points(scanner, true, LOG_RADIUS_MM)

    def feet(fitted: FloatArray) -> FloatArray:
        """Return the feet of the points on the other geometry's rays, turned and scaled."""
        turn, scale = fitted
        source, ends = places(scanner, other, turn, scale)
        along = ends[cells] - source
        along /= np.linalg.norm(along, axis=-1, keepdims=True)
        return source + np.einsum("rpc,rc->rp", points - source, along)[..., None] * along[:, None, :]

    fitted = least_squares(lambda both: (feet(both) - points).ravel(), (0.0, 1.0), xtol=1e-15, ftol=1e-15).x
    distances = np.linalg.norm(feet(fitted) - points, axis=-1)
    stated = ray_error(scanner, true, other, radius_mm=LOG_RADIUS_MM)
    assert math.isclose(float(np.sqrt(np.mean(distances**2))), stated.rms_mm, rel_tol=1e-3), "not the ray error"
    axes.add_patch(plt.Circle((0.0, 0.0), LOG_RADIUS_MM, facecolor="#f3e6d0", edgecolor="#c8a26b", lw=0.8, zorder=0))
    for (source, ends), colour in ((places(scanner, true), "black"), (places(scanner, other, *fitted), RED)):
        axes.plot(*in_picture(source), "o", color=colour, markersize=4)
        for end in in_picture(ends[cells]):
            line(axes, in_picture(source), end, color=colour)
            axes.plot(*end, "s", color=colour, markersize=3)
    for start, end in zip(in_picture(points).reshape(-1, 2), in_picture(feet(fitted)).reshape(-1, 2), strict=True):
        line(axes, start, end, color=BLUE, lw=1.6)
        axes.plot(*start, "o", color=BLUE, markersize=2.5)
    axes.plot(0.0, 0.0, "+", color="black", markersize=9)
    for place, words, colour in (
        ((-350.0, 170.0), "the true rays", "black"),
        ((-350.0, 140.0), "the rays by the calibration,\nturned and scaled to fit best", RED),
        ((-350.0, -130.0), "nine distances on each ray inside\nthe log: their RMS is the ray error", BLUE),
    ):
        axes.text(*place, words, color=colour, ha="center", va="top", fontsize=11)
    show(axes)


def places(
    scanner: Scanner, frame: SourceFrame, turn: float = 0.0, scale: float = 1.0
) -> tuple[FloatArray, FloatArray]:
    """Return source and cells of a geometry, turned about the COR, its R scaled and SDD, u_c and tau unchanged."""
    source = np.array([0.0, -scale * frame.source_distance_mm])
    ends = source + cell_points(scanner, frame)
    return np.stack(rotate(turn, *source), -1), np.stack(rotate(turn, *ends.T), -1)


def same_every_time() -> AbstractContextManager[None]:
    """Return a style with a fixed seed for ids and text as outlines; `write` leaves the date out."""
    return mpl.rc_context({"svg.hashsalt": "geometry", "svg.fonttype": "path", "font.size": 9.0})


def write(figure: Figure, path: Path) -> None:
    """Write the same file in every run, on white: a dark page shows it too."""
    figure.savefig(path, metadata={"Date": None, "Creator": None})
    plt.close(figure)


def main() -> None:
    """Write the drawings."""
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else FOLDER
    geometry = FanBeamGeometry(SCANNER, THETA, np.array([PHI_RAD]))
    with same_every_time():
        figure, (left, right) = plt.subplots(1, 2, figsize=(11.0, 5.6), layout="constrained")
        draw_theta(left, geometry)
        draw_source_frame(right, geometry)
        write(figure, folder / "geometry.svg")
        figure, axes = plt.subplots(figsize=(9.4, 4.4), layout="constrained")
        draw_ray_error(axes)
        write(figure, folder / "ray-error.svg")


if __name__ == "__main__":
    main()
