"""A calibration's report as one HTML page for A4: the first sheet for the technician, the second for the scientist.

The page is self-contained: styles and pictures are inside, there is no script, and nothing is loaded.
"""

from collections.abc import Callable
from dataclasses import dataclass
from datetime import datetime
from functools import cache
from gettext import ngettext

from jinja2 import Environment
from markupsafe import Markup

from sawmill_calibration.pictures import report_numbers as numbers
from sawmill_calibration.pictures.templating import templates_of
from sawmill_contracts.calibrations import CalibrationResult
from sawmill_contracts.phantoms import PhantomDrawing
from sawmill_contracts.scanners import Tolerances
from sawmill_mill.anything_moved import AnythingMoved
from sawmill_mill.next_step import NextStep, step_alone
from sawmill_mill.two_questions import TwoQuestions, in_length, in_mm, in_percent
from sawmill_vocabulary.calibration_arrays import CalibrationArrays
from sawmill_vocabulary.messages import ENGLISH, WORDS, Reader

# Mark and tone of a verdict or an answer.
LOOKS = {"pass": ("✓", "good"), "watch": ("!", "watch"), "fail": ("✕", "bad")}
LOOKS |= {
    "yes": LOOKS["pass"],
    "look": LOOKS["watch"],
    "no": LOOKS["fail"],
    "unknown": ("?", "idle"),
    "accepted": ("·", "idle"),
}


@dataclass(frozen=True)
class About:
    """Context of an answer; None, or empty, where it is not known, as everything is that only a service knows."""

    calibration_id: str | None = None
    made_at: datetime | None = None  # with the zone in which it is shown
    made: str = ""  # the same, as the reader writes it; empty: as programs do
    scanner_name: str | None = None
    scanner_id: str | None = None
    scan_name: str | None = None
    scan_id: str | None = None
    phantom: PhantomDrawing | None = None
    phantom_name: str | None = None  # in the reader's language
    tolerances: Tolerances | None = None
    asked_by: str | None = None  # the person, program or schedule
    active: bool | None = None  # whether the scanner uses the calibration
    activated: str = ""  # when it was activated
    activated_why: str = ""
    step: NextStep | None = None  # with the scanner's state
    origin: str = ""  # the file from which the report was made
    back: str = ""  # address of the page to return to, on a screen


def report_html(
    result: CalibrationResult, about: About, arrays: CalibrationArrays | None, reader: Reader = ENGLISH
) -> str:
    """Write the report as one HTML file.

    Parameters
    ----------
    arrays : CalibrationArrays or None
        Arrays of result.h5; without arrays the page has no pictures of the scan and says so.
    reader : Reader
        Language of the page.

    Raises
    ------
    ValueError
        The arrays do not agree with one another.
    """
    step = about.step or step_alone(result, about.tolerances, active=about.active is True)
    panels = {}
    if arrays is not None:
        # Imported here because matplotlib takes a second, and the demo's page and a report of numbers need no panel.
        from sawmill_calibration.pictures.calibration_report import report_panels  # noqa: PLC0415

        panels = report_panels(result, arrays, reader)
    page = (
        page_templates(reader)
        .get_template("report.html")
        .render(
            result=result,
            about=about,
            both=TwoQuestions.of(result, about.tolerances),
            movement=AnythingMoved.of(result, accepted=about.active is True),
            step=step,
            words=step.reason.in_words(reader),
            reader=reader,
            has_arrays=arrays is not None,
            panels=panels,
            by_total_variation=arrays is not None and arrays.phantom_image_method == "total_variation",
            log=None if arrays is None else arrays.log,
            numbers=numbers,
        )
    )
    return page.lstrip()


def _localised(written: Callable[[float], str], reader: Reader) -> Callable[[float], str]:
    """Return a function that writes a number in the language of the reader."""
    return lambda value: reader.localised(written(value))


def gauge(value: float, limit: float) -> tuple[float, float]:
    """Return the length of the value's bar and the position of the limit's mark, in per cent of the whole length."""
    whole = max(1.3 * limit, 1.05 * value)
    return 100.0 * value / whole, 100.0 * limit / whole


def css_text(text: str) -> Markup:
    """Quote any text as a CSS string."""
    letters = (letter if letter.isascii() and letter.isalnum() else f"\\{ord(letter):06x}" for letter in text)
    return Markup('"' + "".join(letters) + '"')  # noqa: S704 - every other letter is an escape


@cache
def page_templates(reader: Reader = ENGLISH) -> Environment:
    """Return the templates of self-contained pages in a language, with the functions that show a verdict."""
    templates = templates_of("sawmill_calibration.pictures", ["jinja2.ext.i18n"])
    templates.install_gettext_callables(reader.words, ngettext, newstyle=True)  # type: ignore[attr-defined]
    written = {"mm": in_mm, "in_length": in_length, "percent": in_percent}
    templates.filters |= {name: _localised(function, reader) for name, function in written.items()}
    templates.filters |= {"localised": reader.localised, "moment": numbers.moment, "css_text": css_text}
    templates.globals |= {
        "gauge": gauge,
        "reader": reader,
        "spoken": WORDS,
        "marks": {word: mark for word, (mark, _) in LOOKS.items()},
        "tones": {word: tone for word, (_, tone) in LOOKS.items()},
    }
    return templates
