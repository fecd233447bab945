"""Reports of calibrations, as a printable page or one picture, and pictures of reconstructed volumes."""

from datetime import datetime
from pathlib import Path
from typing import Any

from sawmill_calibration.failures import refused
from sawmill_calibration.pictures.report_page import About, report_html
from sawmill_calibration.result_file import read_saved_calibration
from sawmill_contracts.calibrations import CalibrationResult
from sawmill_contracts.phantoms import PhantomDrawing

# ruff: noqa: PLC0415 - drawing is imported only if a picture is requested
from sawmill_contracts.reconstructions import ReconstructionResult
from sawmill_formats.errors import NotStored
from sawmill_vocabulary.calibration_arrays import CalibrationArrays

PAGES = frozenset({".html", ".htm"})


def write_report(path: Path, output: Path) -> bool:
    """Write the report of the calibration in a file as an HTML page; return whether it has pictures of the scan."""
    record = read_saved_calibration(path)
    about = About(
        calibration_id=_text(record.header, "id"),
        made_at=None if record.made_at is None else _local(path, record.made_at),
        scanner_id=_text(record.header, "scanner_id"),
        scan_id=_text(record.header, "scan_id"),
        origin=path.name,
    )
    try:
        page = report_html(record.result, about, record.arrays)
    except (ValueError, IndexError) as error:
        raise refused("calibration", f"the arrays of {path.name} cannot be drawn: {error}") from error
    output.write_text(page, encoding="utf-8")
    return record.arrays is not None


def write_report_of_scan(
    output: Path, result: CalibrationResult, arrays: CalibrationArrays, scan_name: str, phantom: PhantomDrawing
) -> None:
    """Write the report of a scan: a printable page if the name ends in `.html`, otherwise a single picture."""
    if output.suffix.lower() in PAGES:
        about = About(made_at=datetime.now().astimezone(), scan_name=scan_name, phantom=phantom, origin=scan_name)
        output.write_text(report_html(result, about, arrays), encoding="utf-8")
        return
    from sawmill_calibration.pictures.calibration_report import report_png

    output.write_bytes(report_png(result, arrays))


def _local(path: Path, time: datetime) -> datetime:
    try:
        return time.astimezone()
    except (OverflowError, ValueError) as error:
        raise refused(
            "calibration", f"{path.name} was made at {time.isoformat()}, which in UTC is not within the years 1 to 9999"
        ) from error


def _text(header: dict[str, Any], name: str) -> str | None:
    value = header.get(name)
    return value if isinstance(value, str) else None


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

    return side_view_png(side_view(volume, result.shape, "x"), title=name)


def _curve(volume: Path, _: ReconstructionResult, __: str) -> bytes:
    from sawmill_calibration.pictures.figures import alpha_curve_png
    from sawmill_formats.output.volume_reader import alpha_curve

    try:
        columns = alpha_curve(volume)
    except NotStored as missing:
        raise refused(missing.code, f"the volume was written, but {missing}") from missing
    return alpha_curve_png(**columns)
