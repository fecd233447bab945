"""Reports of calibrations: a printable page, or one picture."""

from datetime import datetime
from pathlib import Path
from typing import Any

from sawmill_calibration.failures import refused
from sawmill_calibration.pictures.report_page import About, report_html
from sawmill_calibration.result_file import read_saved_calibration
from sawmill_contracts.calibrations import CalibrationResult
from sawmill_contracts.phantoms import PhantomDrawing
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
    output.write_text(_drawn(path, record.result, about, record.arrays), encoding="utf-8")
    return record.arrays is not None


def write_report_of_scan(
    output: Path, result: CalibrationResult, arrays: CalibrationArrays, scan_name: str, phantom: PhantomDrawing
) -> None:
    """Write the report of a scan: a printable page if the name ends in `.html`, otherwise a single picture."""
    if output.suffix.lower() in PAGES:
        about = About(made_at=datetime.now().astimezone(), scan_name=scan_name, phantom=phantom, origin=scan_name)
        output.write_text(report_html(result, about, arrays), encoding="utf-8")
        return
    from sawmill_calibration.pictures.calibration_report import report_png  # noqa: PLC0415 - matplotlib is slow to import

    output.write_bytes(report_png(result, arrays))


def _local(path: Path, time: datetime) -> datetime:
    try:
        return time.astimezone()
    except (OverflowError, ValueError) as error:
        raise refused(
            "calibration", f"{path.name} was made at {time.isoformat()}, which in UTC is not within the years 1 to 9999"
        ) from error


def _drawn(path: Path, result: CalibrationResult, about: About, arrays: CalibrationArrays | None) -> str:
    try:
        return report_html(result, about, arrays)
    except (ValueError, IndexError) as error:
        raise refused("calibration", f"the arrays of {path.name} cannot be drawn: {error}") from error


def _text(header: dict[str, Any], name: str) -> str | None:
    value = header.get(name)
    return value if isinstance(value, str) else None
