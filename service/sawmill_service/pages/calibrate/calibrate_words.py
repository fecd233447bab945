"""Words of `/calibrate` for stages and changes, and the address of a step, which other pages carry along."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated
from urllib.parse import urlencode

from fastapi import Depends, Query

from sawmill_contracts.calibrations import Comparison, FoundGeometry
from sawmill_platform.contracts.base import Identifier
from sawmill_service.pages.frame.languages import marked
from sawmill_service.pages.frame.page_frame import PageFrame


@dataclass(frozen=True)
class Row:
    """Row of a table: a name, a value, and a remark."""

    name: str
    value: str
    beside: str = ""


def changes_of(page: PageFrame, compared: Comparison | None) -> list[Row]:
    """Return the changes against the calibration that was in use; empty where there was none."""
    if compared is None:
        return []
    _, formats = page.text.gettext, page.formats
    return [
        Row(_("Rays"), formats.mm(compared.ray_change_mm)),
        Row(_("Scale"), formats.percent(compared.scale_change_percent, signed=True)),
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
        for name, label in PARAMETERS.items():
            angle = name.endswith("_rad")
            written = formats.degrees if angle else formats.mm
            value, spread = getattr(frame, name), getattr(spreads, name)
            factor = math.degrees(1.0) if angle else 1.0
            held = _("held, or not known") if spread is None else f"± {written(factor * spread)}"
            yield Row(_(label), written(factor * value), held)

    return list(rows())


PARAMETERS = {
    "psi_rad": marked("First angle (psi)"),
    "source_distance_mm": marked("Source to centre of rotation (R)"),
    "source_to_detector_mm": marked("Source to detector (SDD)"),
    "cor_column_mm": marked("Centre of rotation on the detector (u_c)"),
    "tilt_rad": marked("Tilt of the detector (tau)"),
}


CALIBRATE = "/calibrate"
# A longer list of angles is left out of an address, and typed again.
LONGEST_ANSWER = 2000

_Id = Annotated[Identifier | None, Query()]
_Answer = Annotated[str | None, Query(max_length=LONGEST_ANSWER)]


@dataclass(frozen=True)
class WizardAddress:
    """Parameters in the page's address; `phantom`, `data` and `angles` are answers that were given already."""

    scanner: _Id = None
    inspection: _Id = None
    calibration: _Id = None
    scan: _Id = None
    phantom: _Id = None
    data: _Answer = None
    angles: _Answer = None

    def path(self, page: str = CALIBRATE, **changes: str | None) -> str:
        """Return the address with some parameters changed, of the wizard or of a page that leads back to it."""
        names = {name: value for name, value in (vars(self) | changes).items() if value}
        return f"{page}?{urlencode(names)}" if names else page


TheWizardAddress = Annotated[WizardAddress, Depends()]
