"""From contracts to the science's value objects, and back."""

from sawmill_worker.contracts import calibrations
from sawmill_worker.contracts import geometry as contracts
from sawmill_worker.contracts.phantoms import DiscShape, PhantomDrawing, PolygonShape
from sawmill_worker.tomography.geometry import FloatArray, Scanner, SourceFrame, Theta, ThetaBounds
from sawmill_worker.tomography.phantom import Disc, Phantom, Polygon, Shape
from sawmill_worker.tomography.ray_error import PredictedRayError


def to_scanner(constants: contracts.ScannerConstants) -> Scanner:
    """The scanner's known constants."""
    return Scanner(constants.source_to_cor_mm, constants.num_detector_pixels, constants.detector_pitch_mm)


def to_bounds(bounds: contracts.ThetaBounds | None) -> ThetaBounds | None:
    """Where theta is searched."""
    return None if bounds is None else ThetaBounds(**bounds.model_dump())


def to_theta(theta: contracts.Theta) -> Theta:
    """The calibrated five."""
    return Theta(**theta.model_dump())


def from_theta(theta: Theta) -> contracts.Theta:
    """The calibrated five, as they cross a boundary."""
    return contracts.Theta.model_validate(vars(theta))


def from_frame(frame: SourceFrame) -> contracts.SourceFrame:
    """The source frame, as it crosses a boundary."""
    return contracts.SourceFrame(**vars(frame), magnification=frame.magnification)


def to_frame(frame: contracts.SourceFrame) -> SourceFrame:
    """The source frame without its derived magnification."""
    return SourceFrame(**frame.model_dump(exclude={"magnification"}))


def from_deviation(theta: FloatArray | None, frame: FloatArray) -> calibrations.StandardDeviation:
    """Standard deviations of theta (5,) and of the source frame (6,); null where nothing is known, or was held."""
    of_theta = [None] * len(contracts.ThetaDeviation.model_fields) if theta is None else theta.tolist()
    of_frame = [value if value > 0.0 else None for value in frame.tolist()]
    return calibrations.StandardDeviation(
        theta=contracts.ThetaDeviation.model_validate(
            dict(zip(contracts.ThetaDeviation.model_fields, of_theta, strict=True))
        ),
        source_frame=contracts.SourceFrameDeviation.model_validate(
            dict(zip(contracts.SourceFrameDeviation.model_fields, of_frame, strict=True))
        ),
    )


def from_predicted(predicted: PredictedRayError, radius_mm: float) -> calibrations.PredictedRayError:
    """The ray error that a covariance predicts inside a disc, as it crosses a boundary."""
    return calibrations.PredictedRayError(
        rms=predicted.rms_mm,
        max=predicted.max_mm,
        upper_95=predicted.upper_95_mm,
        interval_95=predicted.interval_95_mm,
        radius_mm=radius_mm,
    )


def to_phantom(drawing: PhantomDrawing) -> Phantom:
    """A phantom as its drawing says."""
    return Phantom(drawing.name, tuple(_to_shape(shape) for shape in drawing.shapes), drawing.size_tolerance)


def from_phantom(phantom: Phantom) -> PhantomDrawing:
    """The drawing of a phantom."""
    shapes = [_from_shape(shape) for shape in phantom.shapes]
    return PhantomDrawing(name=phantom.name, shapes=shapes, size_tolerance=phantom.size_tolerance)


def _to_shape(shape: PolygonShape | DiscShape) -> Shape:
    if isinstance(shape, DiscShape):
        return Disc(shape.center_mm, shape.radius_mm, shape.density)
    return Polygon(tuple(shape.vertices_mm), shape.density)


def _from_shape(shape: Shape) -> PolygonShape | DiscShape:
    if isinstance(shape, Disc):
        return DiscShape(center_mm=shape.center_mm, radius_mm=shape.radius_mm, density=shape.density)
    return PolygonShape(vertices_mm=list(shape.vertices_mm), density=shape.density)
