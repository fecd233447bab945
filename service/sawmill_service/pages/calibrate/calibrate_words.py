"""Words of `/calibrate`: the stages, the changes, and what to do about a failure."""

import math
from collections.abc import Iterator
from dataclasses import dataclass

from sawmill_contracts.calibrations import Comparison, FoundGeometry
from sawmill_contracts.failure_codes import DEFECTS, LIMITS, LOSSES, OUTAGES
from sawmill_platform.contracts.jobs import Failure
from sawmill_service.pages.frame.languages import marked
from sawmill_service.pages.frame.page_frame import PageFrame

# Stages, by the names that jobs report.
STAGES = {
    "read": marked("Reading the file"),
    "prepare": marked("Turning the numbers into attenuation"),
    "align rows": marked("Aligning the rows"),
    "rows": marked("Finding the rows that show the phantom"),
    "search": marked("Searching for the geometry"),
    "log": marked("Comparing with the log beside the phantom"),
    "result": marked("Writing the result"),
    "store": marked("Writing the result"),
}
_EXPORT = marked("Export the scan again and send the new file.")
_PHANTOM = marked("Choose the phantom that was scanned. Is it whole in the beam, with nothing else? Then scan again.")
_ADVICE = {
    "angles-malformed": marked("Write the angles as the sentence shows, and try again."),
    "angles-mismatch": marked("Write one angle for each view, or the first angle and the step, and try again."),
    "calibration": _PHANTOM,
    "counts": marked("Answer the question about the numbers in the other way, and try again."),
    "phantom": _PHANTOM,
    "phantom-not-found": _PHANTOM,
    "phantom-outside-field": _PHANTOM,
    "wrong-shape": marked("Choose the scanner that made this scan, or correct its number of detector cells."),
}
_OURS = marked("This is no fault of yours. Try again; if it stays, tell whoever looks after the service.")
_LARGE = marked("Send a smaller file, with fewer rows or views.")
_OTHER = marked("Try again with other answers. If that does not help, scan the phantom again.")


@dataclass(frozen=True)
class Row:
    """Row of a table: a name, a value, and a remark."""

    name: str
    value: str
    beside: str = ""


def stages(page: PageFrame) -> dict[str, str]:
    """Return the stages of a running job in the page's language, by the names that the job reports."""
    return {name: page.text.gettext(text) for name, text in STAGES.items()}


def advice_for(page: PageFrame, failure: Failure | None, *, unread: bool) -> str:
    """Return what to do about a calibration without an answer or, with `unread`, a scan that could not be read."""
    code = "" if failure is None else failure.code
    if code in DEFECTS | LOSSES | OUTAGES:
        return page.text.gettext(_OURS)
    if code in LIMITS:
        return page.text.gettext(_LARGE)
    return page.text.gettext(_ADVICE.get(code, _EXPORT if unread else _OTHER))


def changes_of(page: PageFrame, compared: Comparison | None) -> list[Row]:
    """Return the changes against the calibration that was in use; empty where there was none."""
    if compared is None:
        return []
    _, formats = page.text.gettext, page.formats
    scale = compared.scale_change_percent
    return [
        Row(_("Rays"), formats.mm(compared.ray_change_mm)),
        Row(_("Scale"), formats.percent(scale, signed=True)),
        Row(_("First angle"), formats.degrees(compared.angle_change_deg, signed=True)),
        Row(_("Centre of rotation on the detector"), formats.mm(compared.cor_column_change_mm, signed=True)),
        Row(_("Distance of the source"), formats.mm(compared.source_distance_change_mm, signed=True)),
        Row(_("Tilt of the detector"), formats.degrees(compared.tilt_change_deg, signed=True)),
    ]


def parameters_of(page: PageFrame, geometry: FoundGeometry) -> list[Row]:
    """Return the geometry that was found, each number with its standard deviation."""
    _, formats, frame = page.text.gettext, page.formats, geometry.source_frame
    spreads = geometry.deviations.source_frame

    def rows() -> Iterator[Row]:
        for name, label in _PARAMETERS.items():
            angle = name.endswith("_rad")
            written = formats.degrees if angle else formats.mm
            value, spread = getattr(frame, name), getattr(spreads, name)
            factor = math.degrees(1.0) if angle else 1.0
            held = _("held, or not known") if spread is None else f"± {written(factor * spread)}"
            yield Row(_(label), written(factor * value), held)

    return list(rows())


_PARAMETERS = {
    "psi_rad": marked("First angle (psi)"),
    "source_distance_mm": marked("Source to centre of rotation (R)"),
    "source_to_detector_mm": marked("Source to detector (SDD)"),
    "cor_column_mm": marked("Centre of rotation on the detector (u_c)"),
    "tilt_rad": marked("Tilt of the detector (tau)"),
}
