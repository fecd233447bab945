"""A scanner seen along its logs, drawn to scale: source, centre of rotation, detector, and the largest log."""

import math
from dataclasses import dataclass

from sawmill_contracts.geometry import ScannerConstants
from sawmill_vocabulary import Theta

Point = tuple[float, float]
MARGIN = 0.09
# Detector's distance over the source's, assumed where no calibration has found it.
ASSUMED_DETECTOR_SHARE = 0.8


@dataclass(frozen=True)
class ScannerDrawing:
    """Drawing of a scanner in mm, y downwards as in SVG, with the COR at (0, 0) and the source below it."""

    # source, detector: source, and the two ends of the detector.
    source: Point
    detector: tuple[Point, Point]
    foot: Point  # (x, y): point in which the ray through the centre of rotation meets the detector
    middle: Point  # (x, y): middle of the detector
    log_radius_mm: float  # radius of the largest log
    box: tuple[float, float, float, float]  # (left, top, width, height): box around the whole drawing
    size_mm: float  # size of a letter that can be read
    tilt_deg: float  # tilt of the detector
    calibrated: bool  # False: the detector is drawn straight, at an assumed distance


def scanner_drawing(constants: ScannerConstants, theta: Theta | None, log_radius_mm: float) -> ScannerDrawing:
    """Draw a scanner by its constants and its active calibration, at the angle of the first view.

    docs/look-up/conventions.md#theta: the source is at (h_S, -r_S), the detector's middle at (-h_D, r_D), and the
    detector's axis runs along (1, alpha_D), with y upwards.
    """
    r_s = constants.source_to_cor_mm
    drawn = theta or Theta(0.0, ASSUMED_DETECTOR_SHARE * r_s, 0.0, 0.0, 0.0)
    source, slope = (drawn.source_shift_mm, r_s), -drawn.detector_tilt
    middle = (-drawn.detector_shift_mm, -drawn.detector_to_cor_mm)
    half = 0.5 * constants.num_detector_pixels * constants.detector_pitch_mm / math.hypot(1.0, slope)
    ends = tuple((middle[0] + side * half, middle[1] + side * half * slope) for side in (-1.0, 1.0))
    radius = min(log_radius_mm, 0.9 * r_s)
    xs = [source[0], middle[0], -radius, radius, *(x for x, _ in ends)]
    ys = [source[1], -radius, radius, *(y for _, y in ends)]
    width, height = max(xs) - min(xs), max(ys) - min(ys)
    margin = MARGIN * max(width, height)
    box = (min(xs) - margin, min(ys) - margin, width + 2 * margin, height + 2 * margin)
    return ScannerDrawing(
        source=source,
        detector=(ends[0], ends[1]),
        foot=_foot(source, middle, slope),
        middle=middle,
        log_radius_mm=radius,
        box=box,
        size_mm=max(box[2], box[3]) / 24,
        tilt_deg=math.degrees(math.atan(drawn.detector_tilt)),
        calibrated=theta is not None,
    )


def _foot(source: Point, middle: Point, slope: float) -> Point:
    """Intersect the line from the source through the origin with the line of the detector."""
    s_x, s_y = source
    # t (-s) on the line y - middle_y = slope (x - middle_x).
    t = (middle[1] - slope * middle[0]) / (slope * s_x - s_y)
    return -t * s_x, -t * s_y
