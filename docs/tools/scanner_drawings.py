"""Draw the scanner and its phantom for people, as SVG in docs/pictures.

    python docs/tools/scanner_drawings.py [FOLDER]

Points come from `FanBeamGeometry`, `Rotation` and the built-in phantom, as in `geometry_drawing.py`.
"""

import math
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
from geometry_drawing import BLUE, GREY, ORIGIN, RED, arc, dimension, line, plt, same_every_time, show, write
from matplotlib.axes import Axes

from sawmill_tomography.geometry.geometry import FanBeamGeometry, FloatArray, Scanner, Theta, cell_borders_mm
from sawmill_tomography.phantoms.built_in import L_SHAPE
from sawmill_tomography.phantoms.phantom import Phantom
from sawmill_vocabulary import Rotation

FOLDER = Path(__file__).parents[1] / "pictures"
# The published scanner's size, with shifts and a tilt that can be seen.
SCANNER = Scanner(source_to_cor_mm=860.0, num_detector_pixels=16, detector_pitch_mm=72.0)
THETA = Theta(
    initial_angle_rad=0.0, detector_to_cor_mm=560.0, source_shift_mm=70.0, detector_shift_mm=60.0, detector_tilt=0.16
)
LOG_RADIUS_MM = 190.0
WOOD, BARK, PALE = "#f3e6d0", "#c8a26b", "#e3e3e3"
BOARD, EDGE, BEAM, STEEL, GREEN, ORANGE = "#d9b27c", "#7d5a2b", "#f4b6ae", "#8a8f94", "#1f6b3f", "#ff8c1a"
PHANTOM = L_SHAPE.scaled(0.55)
# A drawing lies on its side, the beam from left to right.
SIDEWAYS = np.array([[0.0, -1.0], [1.0, 0.0]])
WORDS = {
    "source": "source",
    "axis": "axis of rotation",
    "detector": "detector",
    "wood": "log, phantom on its end",
    "measured": "measure: source to axis",
    "distance": "found: axis to detector",
    "column": "found: where the axis falls",
    "tilt": "found: tilt",
}
NUMBERS = {"source": "1", "axis": "2", "wood": "3", "detector": "4"}


def sideways(points: FloatArray) -> FloatArray:
    """Return points (..., 2) with the beam along x."""
    return points @ SIDEWAYS


def outline(axes: Axes, body: Phantom, place: Callable[[FloatArray], FloatArray] = np.asarray) -> None:
    """Fill the body's outlines."""
    for corners in body.outlines():
        axes.fill(*place(corners).T, facecolor=BOARD, edgecolor=EDGE, lw=1.2, zorder=2)


def draw_scanner(axes: Axes, words: dict[str, str]) -> None:
    """Draw the scanner from above: its parts and, where there are words for them, measured and estimated numbers."""
    source, centre, axis = (sideways(vectors[0]) for vectors in FanBeamGeometry(SCANNER, THETA, np.zeros(1)).vectors())
    cells = centre + cell_borders_mm(SCANNER)[:, None] * axis
    axes.fill(*np.stack([source, cells[0], cells[-1]]).T, color=PALE, alpha=0.5, lw=0, zorder=0)
    axes.add_patch(plt.Circle((0.0, 0.0), LOG_RADIUS_MM, facecolor=WOOD, edgecolor=BARK, lw=1.5, zorder=1))
    outline(axes, PHANTOM, sideways)
    axes.plot(*cells.T, color="black", lw=3.0, marker="_", markersize=7)
    axes.plot(*source, "o", color="black", markersize=11)
    axes.plot(0.0, 0.0, "+", color="black", markersize=14, markeredgewidth=2.0, zorder=4)
    # The log turns clockwise where the source goes round it counter-clockwise, as the angles count.
    arc(axes, LOG_RADIUS_MM + 45.0, 2.0, 0.6, "")
    named = {
        "source": source + np.array([-15.0, 75.0]),
        "axis": np.array([-70.0, 95.0]) if "measured" in words else np.array([-52.0, 52.0]),
        "wood": np.array([0.0, -LOG_RADIUS_MM - 60.0]),
        "detector": max(cells[0], cells[-1], key=lambda end: float(end[1])) + np.array([-15.0, 62.0]),
    }
    for part, place in named.items():
        name(axes, words[part], place)
    if "measured" in words:
        measured_and_found(axes, words, source, centre, axis)
    low, high = axes.get_ylim()
    show(axes, ylim=(low, max(high, named["detector"][1] + 45.0)))
    axes.margins(0.03)


def name(axes: Axes, text: str, place: FloatArray) -> None:
    """Write a part's name, or its number in a disc."""
    disc = {"boxstyle": "circle,pad=0.25", "fc": BLUE, "ec": "none"} if text.isdecimal() else None
    colour = "white" if disc else "black"
    axes.text(*place, text, ha="center", va="center", color=colour, bbox=disc, fontsize=19 if disc else 13, zorder=5)


def measured_and_found(
    axes: Axes, words: dict[str, str], source: FloatArray, centre: FloatArray, axis: FloatArray
) -> None:
    """Draw arrows: blue for what a tape measures, red for what the calibration finds."""
    below = np.array([0.0, -390.0])
    foot = np.array([-SCANNER.source_to_cor_mm, 0.0])
    for end in (foot, ORIGIN):
        line(axes, end if end is ORIGIN else source, end + below, ls=":")
    dimension(axes, foot + below, below, words["measured"], aside=38.0)
    along = -source / np.linalg.norm(source)
    # Where the ray through the axis of rotation meets the detector's line.
    _, column = np.linalg.solve(np.stack([along, -axis], 1), centre)
    shadow = centre + column * axis
    line(axes, source, shadow, ls="--", color=RED)
    far = np.array([THETA.detector_to_cor_mm, 0.0])
    line(axes, far, far + below, ls=":")
    dimension(axes, below, far + below, words["distance"], aside=38.0, colour=RED)
    axes.plot(*shadow, "o", color=RED, markersize=7, zorder=5)
    low = centre - math.copysign(330.0, axis[1]) * axis
    for (x, y), found in ((shadow, "column"), (low, "tilt")):
        axes.text(x + 35.0, y, words[found], color=RED, ha="left", va="center", fontsize=12)
    axes.set_xlim(source[0] - 80.0, centre[0] + 560.0)


def draw_hypotheses(panels: "np.ndarray[tuple[int, int], np.dtype[np.object_]]") -> None:
    """Draw the phantom as drawn and from behind, x down, and the log turning as the angles state and the other way."""
    for row, (seen, body) in enumerate((("as-drawn", L_SHAPE), ("from-behind", L_SHAPE.mirrored()))):
        for column, rotation in enumerate(Rotation):
            axes: Axes = panels[row, column]
            outline(axes, body, sideways)
            # A quarter turn back, as x points down.
            first, last = rotation.apply(np.radians([20.0, 120.0])) - 0.5 * np.pi
            arc(axes, 235.0, float(first), float(last), "")
            # The source goes round the log.
            axes.plot(235.0 * math.cos(first), 235.0 * math.sin(first), "o", color="black", markersize=6)
            axes.plot(0.0, 0.0, "+", color="black", markersize=9)
            axes.set_title(f"handedness {seen}, rotation {rotation}", fontsize=10)
            show(axes, xlim=(-270.0, 270.0), ylim=(-270.0, 270.0))


def draw_measured_phantom(axes: Axes) -> None:
    """Draw where a caliper measures a phantom, x down and y across as on its page: its whole extent, at both ends."""
    outline(axes, L_SHAPE, sideways)
    corners = sideways(L_SHAPE.outlines()[0])
    (left, low), (right, high) = corners.min(axis=0), corners.max(axis=0)
    for aside in (26.0, 62.0):
        dimension(axes, np.array([left, low - aside]), np.array([right, low - aside]), "", aside=0.0)
        dimension(axes, np.array([left - aside, low]), np.array([left - aside, high]), "", aside=0.0)
    axes.text(
        0.5 * (left + right), low - 92.0, "side y, at both ends", color=BLUE, ha="center", va="center", fontsize=12
    )
    axes.text(
        left - 92.0,
        0.5 * (low + high),
        "side x, at both ends",
        color=BLUE,
        ha="center",
        va="center",
        fontsize=12,
        rotation=90,
    )
    show(axes, xlim=(left - 110.0, right + 20.0), ylim=(low - 110.0, high + 20.0))


def draw_mounting(panels: "np.ndarray[tuple[int], np.dtype[np.object_]]") -> None:
    """Draw a phantom from the side: on a log's end, on a turntable, and on a turntable as it must not be."""
    on_the_log, upright, slanting = panels
    draw_phantom_on_a_log(on_the_log)
    draw_phantom_on_a_turntable(upright, slope=0.0)
    draw_phantom_on_a_turntable(slanting, slope=0.22)
    for axes, right in ((on_the_log, True), (upright, True), (slanting, False)):
        mark(axes, right=right, place=np.array([185.0, 205.0]))
        show(axes, xlim=(-240.0, 240.0), ylim=(-215.0, 240.0))


def draw_phantom_on_a_log(axes: Axes) -> None:
    """Draw a board screwed flat to the end of a log that lies on rollers; the beam comes from above."""
    for x in (-150.0, -20.0):
        axes.add_patch(plt.Circle((x, -116.0), 30.0, facecolor=STEEL, lw=0, zorder=1))
    axes.add_patch(plt.Rectangle((-215.0, -85.0), 265.0, 170.0, facecolor=WOOD, edgecolor=BARK, lw=3.0, zorder=1))
    axes.fill([62.0, 50.0, 74.0], [190.0, -190.0, -190.0], color=BEAM, alpha=0.7, lw=0, zorder=0)
    axes.add_patch(plt.Rectangle((50.0, -72.0), 24.0, 144.0, facecolor=BOARD, edgecolor=EDGE, lw=1.5, zorder=3))
    for y in (-45.0, 45.0):
        line(axes, np.array([15.0, y]), np.array([79.0, y]), color="black", lw=2.5, zorder=4)
    line(axes, np.array([-235.0, 0.0]), np.array([150.0, 0.0]), ls="-.", lw=1.2, zorder=5)
    axes.plot(62.0, 190.0, "o", color="black", markersize=10)
    line(axes, np.array([30.0, -190.0]), np.array([94.0, -190.0]), color="black", lw=4.0)
    for number, place in {"1": (115.0, 70.0), "2": (115.0, -45.0), "3": (180.0, 0.0), "4": (105.0, 150.0)}.items():
        name(axes, number, np.array(place))


def draw_phantom_on_a_turntable(axes: Axes, slope: float) -> None:
    """Draw a board clamped to the block on a turntable, level or at a slope; the beam comes from the left."""
    axes.add_patch(plt.Rectangle((-120.0, -170.0), 240.0, 24.0, facecolor=STEEL, lw=0, zorder=1))
    axes.add_patch(plt.Rectangle((-24.0, -200.0), 48.0, 30.0, facecolor=STEEL, lw=0, zorder=1))
    axes.fill([-70.0, 70.0, 70.0, -70.0], [-146.0, -146.0, 70 * slope, -70 * slope], color=PALE, ec=GREY, zorder=1)
    axes.fill([-205.0, 200.0, 200.0], [12.0, 0.0, 24.0], color=BEAM, alpha=0.7, lw=0, zorder=0)
    across, up = np.array([1.0, slope]), np.array([-slope, 1.0])
    corners = np.stack([-105 * across, 105 * across, 105 * across + 24 * up, -105 * across + 24 * up])
    axes.fill(*corners.T, facecolor=BOARD, edgecolor=EDGE, lw=1.5, zorder=3)
    for side in (-50.0, 50.0):
        line(axes, side * across - 25.0 * up, side * across + 30.0 * up, color="black", lw=2.5, zorder=4)
    line(axes, np.array([0.0, -210.0]), np.array([0.0, 120.0]), ls="-.", lw=1.2, zorder=5)
    axes.plot(-205.0, 12.0, "o", color="black", markersize=10)
    line(axes, np.array([205.0, -20.0]), np.array([205.0, 44.0]), color="black", lw=4.0)
    if not slope:
        for number, place in {"1": (-90.0, 60.0), "2": (50.0, 66.0), "3": (0.0, 150.0), "4": (160.0, 50.0)}.items():
            name(axes, number, np.array(place))


def mark(axes: Axes, *, right: bool, place: FloatArray) -> None:
    """Write a green tick or a red cross."""
    axes.text(*place, "✓" if right else "✗", color=GREEN if right else RED, ha="center", va="center", fontsize=26)


def draw_outlines(panels: "np.ndarray[tuple[int], np.dtype[np.object_]]") -> None:
    """Draw a reconstructed phantom under its outline: on the edges, of another phantom, and of one that slipped."""
    at_rest, slipped = (ORIGIN,), (np.array([-11.0, -7.0]), np.array([11.0, 7.0]))
    cases = ((L_SHAPE, at_rest, True), (L_SHAPE.scaled(1.12), at_rest, False), (L_SHAPE, slipped, False))
    for axes, (drawn, places, right) in zip(panels, cases, strict=True):
        axes.add_patch(plt.Rectangle((-190.0, -150.0), 380.0, 300.0, facecolor="#151515", lw=0, zorder=0))
        for place in places:
            for corners in L_SHAPE.outlines():
                axes.fill(*(sideways(corners) + place).T, facecolor="#f0f0f0", alpha=1.0 / len(places), lw=0, zorder=1)
        for corners in drawn.outlines():
            axes.plot(*sideways(np.vstack([corners, corners[:1]])).T, color=ORANGE, lw=2.5, zorder=3)
        mark(axes, right=right, place=np.array([0.0, 178.0]))
        show(axes, xlim=(-192.0, 192.0), ylim=(-155.0, 205.0))


def main() -> None:
    """Write the drawings."""
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else FOLDER
    with same_every_time():
        for name_of_file, words in (("scanner", WORDS), ("scanner-numbers", NUMBERS)):
            figure, axes = plt.subplots(figsize=(11.0, 6.2), layout="constrained")
            draw_scanner(axes, words)
            write(figure, folder / f"{name_of_file}.svg")
        figure, panels = plt.subplots(2, 2, figsize=(7.6, 7.8), layout="constrained")
        draw_hypotheses(panels)
        write(figure, folder / "handedness.svg")
        figure, axes = plt.subplots(figsize=(6.4, 6.0), layout="constrained")
        draw_measured_phantom(axes)
        write(figure, folder / "phantom.svg")
        for name_of_file, draw in (("phantom-mounting", draw_mounting), ("phantom-outline", draw_outlines)):
            figure, panels = plt.subplots(1, 3, figsize=(11.0, 3.9), layout="constrained")
            draw(panels)
            write(figure, folder / f"{name_of_file}.svg")


if __name__ == "__main__":
    main()
