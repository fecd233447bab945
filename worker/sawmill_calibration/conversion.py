"""Conversion of scientific answers to contracts where the two differ in shape, and of drawings to phantoms."""

from dataclasses import fields

from sawmill_contracts import calibrations
from sawmill_contracts.geometry import SourceFrameDeviation, ThetaDeviation
from sawmill_contracts.phantoms import PhantomDrawing
from sawmill_tomography.geometry.geometry import FloatArray
from sawmill_tomography.geometry.ray_error import RayErrorPrediction
from sawmill_tomography.phantoms.phantom import Phantom


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


def from_predicted(predicted: RayErrorPrediction, radius_mm: float) -> calibrations.PredictedRayError:
    """Convert the ray error that a covariance predicts inside a disc to its contract."""
    return calibrations.PredictedRayError(
        rms=predicted.rms_mm,
        max=predicted.max_mm,
        upper_95=predicted.upper_95_mm,
        interval_95=predicted.interval_95_mm,
        radius_mm=radius_mm,
    )


def to_phantom(drawing: PhantomDrawing, size_tolerance_percent: float | None = None) -> Phantom:
    """Convert a drawing to a phantom, with the drawing's size tolerance unless another tolerance is given."""
    tolerance = drawing.size_tolerance if size_tolerance_percent is None else size_tolerance_percent / 100.0
    return Phantom(drawing.name, tuple(drawing.shapes), tolerance)


def from_phantom(phantom: Phantom) -> PhantomDrawing:
    """Convert a phantom to its drawing."""
    return PhantomDrawing.model_validate({field.name: getattr(phantom, field.name) for field in fields(phantom)})
