"""Drift checks without a calibration: the start from a geometry measured by hand, and the corrected theta."""

import math
from dataclasses import replace

import numpy as np

from sawmill_calibration.known_geometry import GivenGeometry
from sawmill_tomography.drift.change import SIGNIFICANT, DetectorFit
from sawmill_tomography.geometry.geometry import FloatArray, Scanner, SourceFrame, Theta, cell_centres_mm
from sawmill_vocabulary import Rotation


def with_coarse_column(
    scanner: Scanner, frame: SourceFrame, sinogram: FloatArray, angles_rad: FloatArray
) -> SourceFrame:
    """Replace u_c by the column about which the centres of mass of the views oscillate once per turn.

    The centre of mass of a body rotates about the COR, so its shadow oscillates about u_c; the fan's second order
    cancels over a full turn (first-order Helgason-Ludwig condition, Natterer 2001, section 2.1). The fits need u_c
    to a few hundredths of the detector.
    """
    u = cell_centres_mm(scanner)
    lines = np.where(np.isfinite(sinogram), sinogram, 0.0)
    mass = lines.sum(axis=1)
    heavy = mass > 0.5 * np.median(mass)
    if not heavy.any():  # no body: the fits refuse the scan
        return frame
    centres = lines[heavy] @ u / mass[heavy]
    phi = angles_rad[heavy]
    swing = np.stack([np.ones_like(phi), np.cos(phi), np.sin(phi)], -1)
    column = float(np.linalg.lstsq(swing, centres)[0][0])
    return replace(frame, cor_column_mm=float(np.clip(column, u[0], u[-1])))


def corrected_theta(geometry: GivenGeometry, fit: DetectorFit) -> Theta:
    """Set u_c and tau to the scan's values at the given SDD, which a ruler measures better than a log shows it."""
    detector = fit.at_distance(geometry.source_frame.source_to_detector_mm)
    corrected = replace(geometry.source_frame, cor_column_mm=detector.cor_column_mm, tilt_rad=detector.tilt_rad)
    sign = int(math.copysign(1, geometry.theta.source_shift_mm))
    return corrected.theta(geometry.scanner.source_to_cor_mm, source_shift_sign=sign)


def found_column(geometry: GivenGeometry, fit: DetectorFit) -> str:
    """Describe what was found and what was kept, in one sentence each, with the `--theta` for a reconstruction."""
    theta, given_sdd_mm = corrected_theta(geometry, fit), geometry.source_frame.source_to_detector_mm
    detector = fit.at_distance(given_sdd_mm)
    (column, tilt), (column_deviation, tilt_deviation) = detector.values, detector.deviations
    written = (
        f"{math.degrees(theta.initial_angle_rad):.8g}deg,{theta.detector_to_cor_mm:.8g},{theta.source_shift_mm:.8g},"
        f"{theta.detector_shift_mm:.8g},{math.degrees(math.atan(theta.detector_tilt)):.6g}deg"
    )
    turned = "" if fit.rotation is Rotation.AS_GIVEN else f" --rotation {fit.rotation.value}"
    sentence = (
        f"the COR falls on the detector at u_c {column:.4g} ± {column_deviation:.2g} mm with a tilt "
        f"of {math.degrees(tilt):.3g} ± {math.degrees(tilt_deviation):.2g} degrees (standard deviations): reconstruct "
        f"with --theta {written}{turned}, in which these two are measured, and R, SDD and the first angle are as given"
    )
    if fit.rotation is not geometry.rotation:
        sentence += f"; the views turn {fit.rotation.value}, not {geometry.rotation.value}"
    distance, deviation = fit.source_to_detector_mm, fit.deviation[2]
    if abs(distance - given_sdd_mm) > SIGNIFICANT * deviation > 0.0:
        sentence += f"; the scan itself shows an SDD of {distance:.5g} ± {deviation:.2g} mm: check the distances"
    return sentence
