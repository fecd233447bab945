"""Pictures of a volume that `sawmill reconstruct` wrote."""
# ruff: noqa: PLC0415 - drawing is imported only if a picture is requested

from pathlib import Path

from sawmill_calibration.failures import refused
from sawmill_contracts.reconstructions import ReconstructionResult
from sawmill_formats.errors import NotStored

MOSAIC_SLICES = 16


def draw_volume(
    volume: Path,
    result: ReconstructionResult,
    name: str,
    *,
    middle: Path | None,
    mosaic: Path | None,
    side: Path | None,
    alpha_curve: Path | None,
) -> None:
    """Draw the middle slice, slices along the log, a side view and the curve of alpha, where a path is given."""
    for path, draw in ((middle, _middle), (mosaic, _mosaic), (side, _side), (alpha_curve, _curve)):
        if path is not None:
            path.write_bytes(draw(volume, result, name))


def _middle(volume: Path, result: ReconstructionResult, name: str) -> bytes:
    from sawmill_calibration.pictures.images import image_png
    from sawmill_formats.output.volume_reader import volume_slice

    middle = volume_slice(volume, result.shape, result.shape[0] // 2)
    title = f"{name}, {middle.label}"
    return image_png(middle.data, pixel_mm=middle.pixel_mm, unit=middle.unit, window=result.value_range, title=title)


def _mosaic(volume: Path, result: ReconstructionResult, name: str) -> bytes:
    from sawmill_calibration.pictures.log_pictures import mosaic_png, spread
    from sawmill_formats.output.volume_reader import volume_slices

    slices = volume_slices(volume, result.shape, spread(MOSAIC_SLICES, result.shape[0]))
    tiles = ((image.data, image.label) for image in slices)
    return mosaic_png(tiles, pixel_mm=result.pixel_mm, unit=result.unit, window=result.value_range, title=name)


def _side(volume: Path, result: ReconstructionResult, name: str) -> bytes:
    from sawmill_calibration.pictures.log_pictures import side_view_png
    from sawmill_formats.output.volume_reader import side_view

    view = side_view(volume, result.shape, "x")
    return side_view_png(
        view.data, across_mm=view.across_mm, across=view.across, along_mm=view.along_mm, unit=view.unit, title=name
    )


def _curve(volume: Path, _: ReconstructionResult, __: str) -> bytes:
    from sawmill_calibration.pictures.figures import alpha_curve_png
    from sawmill_formats.output.volume_reader import alpha_curve

    try:
        columns = alpha_curve(volume)
    except NotStored as missing:
        raise refused(missing.code, f"the volume was written, but {missing}") from missing
    return alpha_curve_png(**columns)
