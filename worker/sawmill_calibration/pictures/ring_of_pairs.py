"""Drawing of a scanner of fixed pairs: sources, detectors and the board, with the error of each pair's rays."""

import math

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from sawmill_calibration.pictures.panels import encoded
from sawmill_contracts.fixed_pairs import CalibratedPair, FixedPairsResult
from sawmill_vocabulary.messages import ENGLISH, N_, Reader

# Half the length of a detector in the drawing, as a share of the source's distance.
DETECTOR = 0.25
COLOURS = ("tab:blue", "tab:orange", "tab:green", "tab:red", "tab:purple", "tab:brown")


def ring_png(result: FixedPairsResult, reader: Reader = ENGLISH) -> bytes:
    """Draw the pairs in their common frame, x downwards and y to the right (docs/look-up/conventions.md#axes)."""
    figure = Figure(figsize=(7.5, 7.5), layout="constrained")
    ax = figure.add_subplot()
    for number, (pair, colour) in enumerate(zip(result.pairs, COLOURS, strict=False), 1):
        _draw_pair(ax, pair, reader.localised(f"{number}: {pair.upper_95_mm:.3f} mm"), colour)
    for number, passage in enumerate(result.passages):
        c, s = math.cos(math.radians(passage.roll_deg)), math.sin(math.radians(passage.roll_deg))
        for line in map(np.array, result.outline_mm):
            x, y = passage.x_mm + line @ [c, -s], passage.y_mm + line @ [s, c]
            ax.plot(y, x, color="saddlebrown", alpha=1.0 - 0.7 * number / len(result.passages))
    turn = np.linspace(0.0, 2.0 * math.pi, 181)
    ax.plot(result.log_radius_mm * np.cos(turn), result.log_radius_mm * np.sin(turn), ":", color="grey")
    title = reader.words(
        N_("Pairs: %(pairs)d. Passages: %(passages)d. Rays: %(rms).3f mm, 95 %% below %(upper).3f mm.")
    )
    counts = {"pairs": len(result.pairs), "passages": len(result.passages)}
    ax.set_title(reader.localised(title % {**counts, "rms": result.predicted_rms_mm, "upper": result.upper_95_mm}))
    ax.set_xlabel("y, mm")
    ax.set_ylabel("x, mm")
    ax.invert_yaxis()
    ax.set_aspect("equal")
    ax.margins(0.15)
    return encoded(figure)


def _draw_pair(ax: Axes, pair: CalibratedPair, label: str, colour: str) -> None:
    """Draw a source, its detector, the ray through the centre, and the upper bound of the rays' error."""
    frame = pair.source_frame
    c, s = math.cos(frame.psi_rad), math.sin(frame.psi_rad)
    source = np.array([frame.source_distance_mm * s, -frame.source_distance_mm * c])
    foot = source * (1.0 - frame.magnification)
    angle = frame.psi_rad + frame.tilt_rad
    half = DETECTOR * frame.source_to_detector_mm * np.array([math.cos(angle), math.sin(angle)])
    ends = np.stack([foot - half, foot + half])
    ax.plot(ends[:, 1], ends[:, 0], color=colour, linewidth=4)
    ax.plot([source[1], foot[1]], [source[0], foot[0]], color=colour, linewidth=0.8)
    ax.plot(source[1], source[0], "o", color=colour, markersize=9)
    ax.annotate(label, (source[1], source[0]), (8, 8), textcoords="offset points", color=colour)
