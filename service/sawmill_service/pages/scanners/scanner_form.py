"""A scanner's settings as a form: what each field means, what was typed, and what is wrong with the text."""

import gettext
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from babel import Locale
from babel.numbers import get_decimal_symbol
from pydantic import ValidationError
from pydantic_core import ErrorDetails

from sawmill_contracts.inspections import InspectedReading
from sawmill_contracts.scanners import ScannerRequest, ScannerSpec, Tolerances
from sawmill_contracts.watched_folders import WatchedFolder
from sawmill_service.pages.frame.languages import marked, plain_number
from sawmill_vocabulary import DataKind, ObjectTurns, Theta


@dataclass(frozen=True)
class FormField:
    """A field: its place in the contract, its texts, and whether it may be left empty.

    A `basic` field has no good default; the letter names its distance in the sketch of a scanner.
    """

    name: str
    place: tuple[str, ...]
    label: str
    hint: str
    wrong: str
    unit: str = "mm"
    whole: bool = False
    needed: bool = True
    basic: bool = False
    letter: str = ""


FIELDS = (
    FormField(
        "source_to_cor_mm",
        ("constants", "source_to_cor_mm"),
        marked("Source to turning axis"),
        marked("From the focal spot of the X-ray tube to the axis that the log turns around. A tape measure will do."),
        marked(
            "Too large: calibrations fail and say that it contradicts the phantom. Too small: the source's sideways "
            "shift comes out too large, and the rays stay right."
        ),
        basic=True,
        letter="A",
    ),
    FormField(
        "num_detector_pixels",
        ("constants", "num_detector_pixels"),
        marked("Detector cells"),
        marked("How many cells one row of the detector has: its data sheet has the number."),
        marked("Wrong: the scan does not fit, and is refused."),
        unit="",
        whole=True,
        basic=True,
        letter="B",
    ),
    FormField(
        "detector_pitch_mm",
        ("constants", "detector_pitch_mm"),
        marked("Detector pitch"),
        marked(
            "From the middle of one cell to the middle of the next: on the data sheet, or the width over the cells."
        ),
        marked("One per cent wrong: the detector's distance comes out one per cent wrong, and the rays stay right."),
        basic=True,
        letter="C",
    ),
    FormField(
        "detector_arc_radius_mm",
        ("constants", "detector_arc_radius_mm"),
        marked("Radius of a curved detector"),
        marked("From the cells to the centre of the arc on which they lie. Empty: a straight detector."),
        marked("Wrong: rays are wrong towards the detector's ends, and a calibration may blame something else."),
        needed=False,
    ),
    FormField(
        "row_pitch_mm",
        ("constants", "row_pitch_mm"),
        marked("Row pitch"),
        marked("From one row of the detector to the next. Leave it empty if nobody knows it."),
        marked("Wrong: logs look too long or too short. Empty: slices have no spacing."),
        needed=False,
        letter="D",
    ),
    FormField(
        "log_radius_mm",
        ("log_radius_mm",),
        marked("Radius of the largest log"),
        marked("Half of the thickest log's diameter: errors of rays are counted in this disc. Empty: by the phantom."),
        marked("Too small: a verdict looks better than the bark of the largest log will be."),
        needed=False,
        letter="E",
    ),
    FormField(
        "ray_error_mm",
        ("tolerances", "predicted_ray_error_mm"),
        marked("Tolerance of the rays"),
        marked("A calibration passes if its rays are right to this, in 95 of 100 cases."),
        marked("Too small: good calibrations do not pass. Too large: blurred images pass."),
    ),
    FormField(
        "scale_percent",
        ("tolerances", "scale_percent"),
        marked("Tolerance of the millimetres"),
        marked("What sizes in the image may be off by."),
        marked("Half a per cent is 1.5 mm on a log of 300 mm."),
        unit="%",
    ),
    FormField(
        "ray_change_mm",
        ("tolerances", "ray_change_mm"),
        marked("Tolerance of movement"),
        marked("How far the rays may move from the active calibration before the scanner is shown red."),
        marked("Too small: red for nothing. Too large: a scanner that has moved stays green."),
    ),
    FormField(
        "phantom_scan_every_days",
        ("alarms", "phantom_scan_every_days"),
        marked("Longest time between two phantom scans"),
        marked("In days: an alarm comes when no phantom was scanned for longer. Empty: none comes."),
        marked("Too short: alarms for nothing. Empty: nobody hears that the phantom was forgotten."),
        unit="d",
        needed=False,
    ),
    FormField(
        "quiet_after_hours",
        ("alarms", "quiet_after_hours"),
        marked("Longest silence"),
        marked("In hours: an alarm comes when the scanner sent no scan for longer. Empty: none comes."),
        marked("Shorter than a weekend: an alarm each weekend. Empty: nobody hears that scans no longer arrive."),
        unit="h",
        needed=False,
    ),
)
FOLDER, FOLDER_DATA = "watched_folder", "watched_folder_data"
TURNS, IMPORTED = "object_turns", "imported_theta"
_BY_PLACE = {each.place: each.name for each in FIELDS} | {(name,): name for name in ("name", FOLDER, IMPORTED)}
# Errors of pydantic: the name of the limit in the details, and the sentence.
_LIMITS = {
    "greater_than": ("gt", marked("must be more than %(limit)s, not %(value)s")),
    "greater_than_equal": ("ge", marked("must be %(limit)s or more, not %(value)s")),
    "less_than": ("lt", marked("must be less than %(limit)s, not %(value)s")),
    "less_than_equal": ("le", marked("must be %(limit)s or less, not %(value)s")),
}


@dataclass
class ScannerForm:
    """Texts of the fields, and what is wrong with them; `further` belongs to no field.

    `read_from_file` has the names of the fields whose texts are as a scan's file states them.
    """

    values: dict[str, str]
    errors: dict[str, str] = field(default_factory=dict)
    further: list[str] = field(default_factory=list)
    read_from_file: set[str] = field(default_factory=set)
    is_outdated: bool = False  # somebody else changed the scanner since the form was opened

    @property
    def is_wrong(self) -> bool:
        """True if anything has to be changed."""
        return bool(self.errors or self.further or self.is_outdated)

    @property
    def opens_rest(self) -> bool:
        """True if a field with a good default needs attention."""
        return (
            bool(self.further)
            or FOLDER in self.errors
            or any(each.name in self.errors for each in FIELDS if not each.basic)
        )


class ScannerForms:
    """Reader and writer of forms in one language and its locale's decimals."""

    def __init__(self, locale: Locale, text: gettext.NullTranslations) -> None:
        self._decimal = get_decimal_symbol(locale)
        self._text = text

    def empty(self) -> ScannerForm:
        """Return the form of a new scanner, in which the tolerances are filled in already."""
        defaults = {"tolerances": Tolerances().model_dump()}
        numbers = {each.name: _at(defaults, each.place) if each.place[0] in defaults else None for each in FIELDS}
        texts = {name: self._number(value) for name, value in numbers.items()}
        turns = ObjectTurns.IN_ONE_SCAN.value
        return ScannerForm({"name": "", TURNS: turns, IMPORTED: "", **_folder_texts(None), **texts})

    def filled(self, form: ScannerForm, reading: InspectedReading) -> ScannerForm:
        """Fill the empty fields of a form that nobody typed with what a scan's file states; mark them in any form."""
        stated = {
            "num_detector_pixels": reading.shape.detector,
            "detector_pitch_mm": reading.detector_pitch_mm,
            "row_pitch_mm": reading.row_pitch_mm,
            "detector_arc_radius_mm": reading.detector_arc_radius_mm,
        }
        texts = {name: self._number(value) for name, value in stated.items() if value is not None}
        if not form.is_wrong:
            form.values |= {name: text for name, text in texts.items() if not form.values[name]}
        form.read_from_file = {name for name, text in texts.items() if form.values[name] == text}
        return form

    def of(self, spec: ScannerSpec) -> ScannerForm:
        """Write a scanner's description into a form."""
        values = spec.model_dump(mode="json")
        texts = {each.name: self._number(_at(values, each.place)) for each in FIELDS}
        texts |= {TURNS: spec.constants.object_turns.value, **_folder_texts(spec.watched_folder)}
        return ScannerForm({"name": spec.name, IMPORTED: _imported_text(spec), **texts})

    def mark_outdated(self, form: ScannerForm, stored: ScannerSpec) -> None:
        """Mark the fields of a form that differ from what is stored now."""
        form.is_outdated, now = True, self.of(stored).values
        sentence = self._text.gettext("“%(value)s” is stored now.")
        form.errors = {name: sentence % {"value": text} for name, text in now.items() if text != form.values[name]}

    def read(self, typed: Mapping[str, str], stored: ScannerSpec | None) -> tuple[ScannerForm, ScannerRequest | None]:
        """Read what somebody typed: the form, and its scanner unless something is wrong; other stored values stay."""
        names = ("name", TURNS, IMPORTED, FOLDER, FOLDER_DATA, *(each.name for each in FIELDS))
        form = ScannerForm({name: typed.get(name, "").strip() for name in names})
        own = set(ScannerSpec.model_fields)
        document: dict[str, Any] = {} if stored is None else stored.model_dump(mode="json", include=own)
        document["name"] = form.values["name"]
        for each in FIELDS:
            _put(document, each.place, self._read_number(each, form))
        if form.values[TURNS]:
            _put(document, ("constants", TURNS), form.values[TURNS])
        folder = {"folder": form.values[FOLDER], "data": form.values[FOLDER_DATA]}
        document[FOLDER] = {**(document.get(FOLDER) or {}), **folder} if form.values[FOLDER] else None
        self._read_imported(form, document, stored)
        spec = None
        try:
            spec = ScannerRequest.model_validate(document)
        except ValidationError as error:
            for detail in error.errors():
                self._place(form, detail)
        return form, None if form.is_wrong else spec

    def _read_imported(self, form: ScannerForm, document: dict[str, Any], stored: ScannerSpec | None) -> None:
        """Put the imported geometry into the document, unless its text is as it was."""
        written = form.values[IMPORTED]
        if written == _imported_text(stored):
            return
        try:
            document[IMPORTED] = Theta.numbers(written) if written else None
        except ValueError:
            sentence = self._text.gettext("must be five numbers, as in %(example)s, not “%(value)s”")
            form.errors[IMPORTED] = sentence % {"example": "146.1deg,714.7,319.9,43.7,15.7deg", "value": written}

    def _read_number(self, each: FormField, form: ScannerForm) -> float | None:
        written = form.values[each.name]
        if not written:
            if each.needed:
                form.errors[each.name] = self._text.gettext("This is needed.")
            return None
        number = plain_number(written)
        if re.fullmatch(r"-?[0-9]{1,15}" if each.whole else r"-?[0-9]{1,15}(\.[0-9]{1,15})?", number) is None:
            example = "768" if each.whole else "859.46".replace(".", self._decimal)
            sentence = self._text.gettext("must be a number, as in %(example)s, not “%(value)s”")
            form.errors[each.name] = sentence % {"example": example, "value": written}
            return None
        return int(number) if each.whole else float(number)

    def _place(self, form: ScannerForm, detail: ErrorDetails) -> None:
        """Assign a complaint to its field."""
        place = tuple(str(part) for part in detail["loc"])
        message = detail["msg"].removeprefix("Value error, ")
        # A complaint about two fields names the first one.
        named = next((each.name for each in FIELDS if message.startswith(".".join(each.place) + " ")), None)
        name = _BY_PLACE.get(place[:2]) or _BY_PLACE.get(place[:1]) or named
        if name in form.errors:
            return  # a text that is missing or no number is no value to judge
        if name is None:
            form.further.append(f"{'.'.join(place)}: {message}" if place else message)
        elif detail["type"] in _LIMITS:
            limit, sentence = _LIMITS[detail["type"]]
            values = {"limit": self._number(detail["ctx"][limit]), "value": form.values[name]}
            form.errors[name] = self._text.gettext(sentence) % values
        elif name == "name" and not form.values["name"]:
            form.errors[name] = self._text.gettext("This is needed.")
        else:
            form.errors[name] = message

    def _number(self, value: float | None) -> str:
        return "" if value is None else f"{value:.10g}".replace(".", self._decimal)


def _folder_texts(watched: WatchedFolder | None) -> dict[str, str]:
    if watched is None:
        return {FOLDER: "", FOLDER_DATA: DataKind.COUNTS.value}
    return {FOLDER: watched.folder, FOLDER_DATA: watched.data.value}


def _imported_text(spec: ScannerSpec | None) -> str:
    return "" if spec is None or spec.imported_theta is None else spec.imported_theta.written(12)


def _at(document: Mapping[str, Any], place: tuple[str, ...]) -> Any:  # noqa: ANN401 - a number or nothing
    value: Any = document
    for part in place:
        value = value[part]
    return value


def _put(document: dict[str, Any], place: tuple[str, ...], value: float | str | None) -> None:
    for part in place[:-1]:
        document = document.setdefault(part, {})
    document[place[-1]] = value
