"""Words of the pages for a phantom: its size, how well that is known, and whether it must be measured again."""

from dataclasses import dataclass
from datetime import date, timedelta

from babel.dates import format_timedelta

from sawmill_contracts.phantoms import PhantomDrawing, SizeMeasurement, StoredPhantom
from sawmill_service.pages.frame.languages import Formats
from sawmill_service.pages.frame.page_frame import PageFrame

# Time from the first warning to the expiry: enough to find the caliper.
SOON = timedelta(days=30)
# Ages are given in a unit from two of that unit on: 14 months are not a year.
_TWO = 2.0


@dataclass(frozen=True)
class SizeKnown:
    """Accuracy of a phantom's size, for people: a word with its tone, and a sentence."""

    tone: str
    word: str
    sentence: str


def size_text(drawing: PhantomDrawing, formats: Formats) -> str:
    """Write the size along x and y."""
    along_x, along_y = drawing.extent_mm
    return f"{formats.number(along_x, 1)} \N{MULTIPLICATION SIGN} {formats.mm(along_y, 1)}"


def size_known(phantom: StoredPhantom, page: PageFrame, today: date) -> SizeKnown:
    """Judge how well the size is known, by the measurements and their own expiry."""
    measured = phantom.drawing.measurements if phantom.drawing else []
    if not measured:
        return _unmeasured(phantom, page)
    _ = page.text.gettext
    when = _last_measured(measured, page, today)
    if any(each.expired(today) for each in measured):
        return SizeKnown("watch", _("Measure again"), _("%(when)s: measure it again.") % {"when": when})
    if phantom.drawing is not None and (unmeasured := phantom.drawing.axis_as_drawn) is not None:
        return _along_one_axis(when, unmeasured, page)
    ends = min((each.expires_on for each in measured if each.expires_on is not None), default=None)
    formats = page.formats
    if ends is not None and ends - today <= SOON:
        sentence = _("%(when)s. Measure it again by %(day)s.") % {"when": when, "day": formats.day(ends.isoformat())}
        return SizeKnown("watch", _("Measure soon"), sentence)
    if ends is not None:
        sentence = _("%(when)s, good until %(day)s.") % {"when": when, "day": formats.day(ends.isoformat())}
        return SizeKnown("good", _("Measured"), sentence)
    return SizeKnown("good", _("Measured"), _("%(when)s, with no day on which to repeat it.") % {"when": when})


def _along_one_axis(when: str, unmeasured: str, page: PageFrame) -> SizeKnown:
    _ = page.text.gettext
    axes = {"axis": "x" if unmeasured == "y" else "y", "other": unmeasured}
    sentence = _("%(when)s, along %(axis)s only: along %(other)s it is as it was drawn. Measure that side too.")
    return SizeKnown("watch", _("Measured along %(axis)s only") % axes, sentence % {"when": when, **axes})


def _unmeasured(phantom: StoredPhantom, page: PageFrame) -> SizeKnown:
    _ = page.text.gettext
    if phantom.built_in:
        return SizeKnown("idle", _("As published"), _("The size of one published board: measure yours."))
    return SizeKnown("idle", _("Not measured"), _("Its size is as it was drawn: measure its sides."))


def _last_measured(measured: list[SizeMeasurement], page: PageFrame, today: date) -> str:
    """Write when the phantom was measured last, and with what."""
    _ = page.text.gettext
    last = max(measured, key=lambda each: each.measured_on or date.min)
    if last.measured_on is None:
        when = _("Measured, it is not known when")
    elif last.measured_on == today:
        when = _("Measured today")
    elif last.measured_on > today:
        when = _("Measured on %(day)s") % {"day": page.formats.day(last.measured_on.isoformat())}
    else:
        ago = format_timedelta(
            last.measured_on - today, granularity="day", threshold=_TWO, add_direction=True, locale=page.language
        )
        when = _("Measured %(ago)s") % {"ago": ago}
    return when if last.instrument is None else _("%(when)s by %(what)s") % {"when": when, "what": last.instrument}
