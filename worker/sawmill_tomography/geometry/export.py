"""The geometry in the conventions of ODL, CIL and RTK; ASTRA's is `FanBeamGeometry.astra_vectors`.

Equal terms of these toolkits differ in sense of rotation, in the zero of the angle and in the direction of the
detector's normal; every function here says in which frame its toolkit's image is.
"""

import math
from typing import Any

import numpy as np

from sawmill_tomography.geometry.geometry import FanBeamGeometry, rotate


def odl_arguments(geometry: FanBeamGeometry) -> dict[str, Any]:
    """Return the arguments of ODL 1.0's `FanBeamGeometry`, lengths in mm; its image is ours, [x, y].

    Returns
    -------
    dict
        `angles_rad` rise strictly, as ODL's partitions require: ODL's view k is the scan's view `view_order[k]`.
        `detector_min_mm`, `detector_max_mm` and `num_detector_pixels` define the detector's uniform partition. The
        other items are arguments by their own names, but for `src_shift_mm` and `det_shift_mm`, constant values of the
        shift functions, (along the ray, along the tangent).
    """
    geometry.check_even()
    scanner, theta = geometry.scanner, geometry.theta
    half = 0.5 * scanner.num_detector_pixels * scanner.detector_pitch_mm
    order = np.argsort(geometry.angles_rad, kind="stable")
    axis = rotate(theta.initial_angle_rad + math.atan(theta.detector_tilt), 1.0, 0.0)
    return {
        "angles_rad": geometry.angles_rad[order].tolist(),
        "view_order": order.tolist(),
        "detector_min_mm": -half,
        "detector_max_mm": half,
        "num_detector_pixels": scanner.num_detector_pixels,
        "src_radius": scanner.source_to_cor_mm,
        "det_radius": theta.detector_to_cor_mm,
        "src_to_det_init": [float(part) for part in rotate(theta.initial_angle_rad, 0.0, 1.0)],
        "det_axis_init": [float(part) for part in axis],
        "src_shift_mm": [0.0, theta.source_shift_mm],
        "det_shift_mm": [0.0, theta.detector_shift_mm],
    }


def cil_arguments(geometry: FanBeamGeometry) -> dict[str, Any]:
    """Return arguments of CIL's `AcquisitionGeometry.create_Cone2D`, `set_angles` and `set_panel`; its image is ours.

    CIL turns the object counter-clockwise, so its source moves in the opposite sense to ours. It also turns every
    system until the ray to the middle of the detector runs along +y, and its image with it; these arguments already
    have that direction, and the turn is in the angles.
    """
    geometry.check_even()
    scanner, theta = geometry.scanner, geometry.theta
    source = np.array([theta.source_shift_mm, -scanner.source_to_cor_mm])
    centre = np.array([-theta.detector_shift_mm, theta.detector_to_cor_mm])
    turn, tilt = math.atan2(*(centre - source)), math.atan(theta.detector_tilt)
    angles = -(geometry.angles_rad + theta.initial_angle_rad - turn)

    def aligned(x: float, y: float) -> list[float]:
        return [float(part) for part in rotate(turn, x, y)]

    return {
        "create_Cone2D": {
            "source_position": aligned(*source),
            "detector_position": aligned(*centre),
            "detector_direction_x": aligned(math.cos(tilt), math.sin(tilt)),
            "rotation_axis_position": [0.0, 0.0],
            "units": "mm",
        },
        "set_angles": {"angles": np.rad2deg(angles).tolist(), "angle_unit": "degree"},
        "set_panel": {"num_pixels": scanner.num_detector_pixels, "pixel_size": scanner.detector_pitch_mm},
    }


def rtk_arguments(geometry: FanBeamGeometry) -> dict[str, Any]:
    """Return the parameters of RTK's `ThreeDCircularProjectionGeometry`, and the matrices that it makes of them.

    RTK turns about its y axis: RTK's (x, y, z) is our (x, along the log, -y). Distances count along the detector's
    normal and offsets along the detector, so that its tilt is a part of the gantry angle: the in-plane and out-of-plane
    angles, which lean a flat panel out of the fan, are 0.

    Returns
    -------
    dict
        Lengths in mm by RTK's names, `GantryAngle` (views,) in [0, 360) degrees, and `Matrix` (views, 3, 4).
    """
    geometry.check_even()
    scanner, theta = geometry.scanner, geometry.theta
    tilt = math.atan(theta.detector_tilt)
    # Rotated by minus the tilt, the detector lies along x and its normal, towards the source, along -y.
    source_x, source_y = (float(part) for part in rotate(-tilt, theta.source_shift_mm, -scanner.source_to_cor_mm))
    centre_x, centre_y = (float(part) for part in rotate(-tilt, -theta.detector_shift_mm, theta.detector_to_cor_mm))
    sid, sdd = -source_y, centre_y - source_y
    gantry = geometry.angles_rad + theta.initial_angle_rad + tilt
    c, s = np.cos(gantry), np.sin(gantry)
    zero, one = np.zeros_like(c), np.ones_like(c)
    # RTK's axes of the detector: along its cells, and towards the source.
    along, towards = np.stack([c, zero, -s, zero], -1), np.stack([s, zero, c, -sid * one], -1)
    # The point where the ray from the source through p meets the detector (RTK's ProjectionGeometry).
    first = -sdd * (along - [0.0, 0.0, 0.0, source_x]) + (source_x - centre_x) * towards
    return {
        "SourceToIsocenterDistance": sid,
        "SourceToDetectorDistance": sdd,
        "SourceOffsetX": source_x,
        "ProjectionOffsetX": centre_x,
        "GantryAngle": np.mod(np.rad2deg(gantry), 360.0),
        "Matrix": np.stack([first, np.stack([zero, -sdd * one, zero, zero], -1), towards], axis=1),
    }
