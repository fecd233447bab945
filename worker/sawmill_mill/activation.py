"""The rule by which a calibration of a schedule or of a request activates itself."""

from typing import NamedTuple

from sawmill_vocabulary import Verdict


class FinishedCalibration(NamedTuple):
    """A calibration that has succeeded.

    Attributes
    ----------
    activates : bool
        Whether its schedule or its request wants activation on pass.
    rays_verdict : Verdict
        The verdict on the rays alone; of an answer of an earlier version the whole verdict.
    has_moved : bool
        Whether the scanner has moved by more than its tolerance since the active calibration.
    """

    activates: bool
    schedule_id: str | None
    rays_verdict: Verdict
    has_moved: bool


def activation_reason(calibration: FinishedCalibration) -> str | None:
    """Return why a calibration activates itself; None where it does not.

    An uncertain scale makes an image larger or smaller and blurs nothing: the verdict on the rays decides. A schedule
    never takes over a scanner that has moved: a technician has to see and to accept that.
    """
    is_scheduled = calibration.schedule_id is not None
    if not calibration.activates or calibration.rays_verdict != "pass" or (is_scheduled and calibration.has_moved):
        return None
    asker = f"schedule {calibration.schedule_id}" if is_scheduled else "the request"
    return f"the rays pass; {asker} asked for activation on pass"
