"""The rule by which a calibration of a schedule or of a request activates itself."""

from sawmill_vocabulary import Verdict


def activation_reason(*, wanted: bool, schedule_id: str | None, rays_verdict: Verdict, has_moved: bool) -> str | None:
    """Return why a finished calibration activates itself; None where it does not.

    Activation on pass has to be `wanted`. An uncertain scale makes an image larger or smaller and blurs nothing: the
    verdict on the rays decides. A schedule never takes over a scanner that has moved by more than its tolerance since
    the active calibration: a technician has to see and to accept that.
    """
    if not wanted or rays_verdict != "pass" or (schedule_id is not None and has_moved):
        return None
    asker = "the request" if schedule_id is None else f"schedule {schedule_id}"
    return f"the rays pass; {asker} asked for activation on pass"
