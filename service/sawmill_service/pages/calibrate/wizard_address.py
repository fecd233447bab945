"""Address of a step of `/calibrate`, which pages that make a new scanner or phantom for it carry along."""

from dataclasses import dataclass
from typing import Annotated
from urllib.parse import urlencode

from fastapi import Depends, Query

from sawmill_platform.contracts.base import Identifier

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
