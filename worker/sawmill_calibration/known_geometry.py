"""The geometry that a scan is used with; conversion of scientific answers to contracts, and of drawings.

A phantom's drawing is built-in, read from a file or traced from a picture.
"""
# ruff: noqa: PLC0415 - a built-in phantom needs no readers of files and pictures

import json
import math
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np
from pydantic import ValidationError

from sawmill_calibration.failures import input_errors_translated, memory_available, options_of, read_json, refused
from sawmill_contracts import calibrations
from sawmill_contracts.calibrations import CalibrationResult
from sawmill_contracts.geometry import ScannerConstants, SourceFrameDeviation, ThetaDeviation
from sawmill_contracts.phantoms import BUILT_IN_PHANTOMS, PhantomDrawing, PhantomPicture, PhantomRequest
from sawmill_platform.contracts.base import complaint
from sawmill_tomography.geometry.contrast_loss import contrast_loss_bound
from sawmill_tomography.geometry.geometry import FanBeamGeometry, FloatArray, Scanner, SourceFrame, Theta
from sawmill_tomography.geometry.ray_error import RayErrorPrediction
from sawmill_tomography.phantoms.phantom import Phantom
from sawmill_tomography.reconstruction.object_extent import seen_radius_mm
from sawmill_vocabulary import LARGEST_ASSUMED_LOG_RADIUS_MM, STANDARD_SIZE_TOLERANCE, Handedness, Rotation
from sawmill_vocabulary.scattered_radiation import NOTHING_FOUND, BeamCorrection

CONSTANTS = ("source_to_cor_mm", "num_detector_pixels", "detector_pitch_mm")


@dataclass(frozen=True)
class GivenGeometry:
    """A geometry given by numbers, without error bars; for a drift check of nominal distances."""

    scanner: ScannerConstants
    theta: Theta
    rotation: Rotation = Rotation.AS_GIVEN
    handedness: Handedness = Handedness.AS_DRAWN
    covariance: None = None
    beam: BeamCorrection = NOTHING_FOUND

    @property
    def source_frame(self) -> SourceFrame:
        """Source frame of theta."""
        return self.theta.source_frame(self.scanner.source_to_cor_mm)

    @property
    def radius_mm(self) -> float:
        """Radius of the disc in which rays are compared: what the detector sees, at most the largest assumed log."""
        seen = seen_radius_mm(FanBeamGeometry(self.scanner, self.theta, np.zeros(1)))
        return min(LARGEST_ASSUMED_LOG_RADIUS_MM, seen)


KnownGeometry = CalibrationResult | GivenGeometry


def check_same_scanner(
    calibrated: ScannerConstants, of_scan: ScannerConstants, names: tuple[str, ...] = CONSTANTS
) -> None:
    """Refuse a calibration whose scanner has other constants of these names than the scan's."""
    for name in names:
        before, now = getattr(calibrated, name), getattr(of_scan, name)
        if not math.isclose(now, before, rel_tol=1e-6):
            raise refused(
                "contradiction",
                f"the calibration is of a scanner with {name} {before:.9g} and the scan has {now:.9g}: "
                "use the calibration of the same scanner",
            )


def from_deviation(theta: FloatArray | None, frame: FloatArray) -> calibrations.StandardDeviation:
    """Convert standard deviations of theta (5,) and of the source frame (6,); null where nothing is known."""
    of_theta = [None] * len(ThetaDeviation.model_fields) if theta is None else theta.tolist()
    of_frame = [value if value > 0.0 else None for value in frame.tolist()]
    return calibrations.StandardDeviation(
        theta=ThetaDeviation.model_validate(dict(zip(ThetaDeviation.model_fields, of_theta, strict=True))),
        source_frame=SourceFrameDeviation.model_validate(
            dict(zip(SourceFrameDeviation.model_fields, of_frame, strict=True))
        ),
    )


def from_predicted(
    predicted: RayErrorPrediction, scanner: Scanner, frame: SourceFrame, covariance: FloatArray, radius_mm: float
) -> calibrations.PredictedRayError:
    """Convert the ray error that a covariance predicts inside a disc, and the contrast that it costs, to the contract.

    `predicted_ray_error` explains the arguments.
    """
    return calibrations.PredictedRayError(
        rms=predicted.rms_mm,
        max=predicted.max_mm,
        upper_95=predicted.upper_95_mm,
        interval_95=predicted.interval_95_mm,
        radius_mm=radius_mm,
        contrast_loss=contrast_loss_bound(scanner, frame, covariance, predicted.upper_95_mm, radius_mm=radius_mm),
    )


def to_phantom(drawing: PhantomDrawing, size_tolerance_percent: float | None = None) -> Phantom:
    """Convert a drawing to a phantom, with the drawing's size tolerance unless another tolerance is given."""
    tolerance = drawing.size_tolerance if size_tolerance_percent is None else size_tolerance_percent / 100.0
    return Phantom(drawing.name, tuple(drawing.shapes), tolerance, drawing.precision_mm)


def from_phantom(phantom: Phantom) -> PhantomDrawing:
    """Convert a phantom to its drawing."""
    return PhantomDrawing.model_validate({field.name: getattr(phantom, field.name) for field in fields(phantom)})


def drawing_of(phantom: Phantom | str | Path, width_mm: float | None = None) -> PhantomDrawing:
    """Return a phantom's drawing by its built-in name, from a JSON file, a packed scan, or a picture of this width."""
    if width_mm is not None:
        if isinstance(phantom, Phantom) or not Path(phantom).is_file():
            raise refused("phantom", f"phantom_width_mm belongs to the path of a picture (PNG), not to {phantom!r}")
        picture = options_of(PhantomPicture, {"name": Path(phantom).stem, "width_mm": width_mm})
        return traced_drawing(Path(phantom), picture.width_mm, name=picture.name)
    if isinstance(phantom, Phantom):
        try:
            return from_phantom(phantom)
        except ValidationError as error:
            raise refused("phantom", complaint(error)) from error
    if phantom in BUILT_IN_PHANTOMS:
        return BUILT_IN_PHANTOMS[str(phantom)]
    if not Path(phantom).is_file():
        raise refused("phantom", f"a phantom must be {', '.join(BUILT_IN_PHANTOMS)} or a file, not {str(phantom)!r}")
    if Path(phantom).suffix.lower() == ".h5":
        from sawmill_formats.input.own import read_calibration_json
        from sawmill_formats.output.scan_layout import DRAWING
        from sawmill_formats.reading_apart import read_apart

        with input_errors_translated():
            read_apart(Path(phantom))
            return options_of(PhantomRequest, json.loads(read_calibration_json(Path(phantom), DRAWING)))
    return read_json(Path(phantom), PhantomRequest, code="phantom", otherwise="not a phantom's drawing")


def traced_drawing(
    path: Path, width_mm: float, *, name: str, size_tolerance: float = STANDARD_SIZE_TOLERANCE
) -> PhantomDrawing:
    """Trace the drawing in a PNG of this width, or refuse it."""
    from sawmill_formats.input.picture import read_picture
    from sawmill_tomography.phantoms.tracing import trace

    with input_errors_translated():
        picture = read_picture(path, free_bytes=memory_available())
        try:
            return from_phantom(trace(picture, width_mm, name=name, size_tolerance=size_tolerance))
        except ValidationError as error:
            raise refused("phantom", f"the picture shows no phantom that can be drawn: {complaint(error)}") from error
