"""The rules of retention as a person types them: days, and GB, which are 10^9 bytes."""

import gettext
import re
from collections.abc import Mapping
from dataclasses import dataclass, field

from babel import Locale
from babel.numbers import format_decimal

from sawmill_contracts.retention import (
    LARGEST_BYTES,
    LONGEST_DAYS,
    RetentionKind,
    RetentionRules,
    StaysBecause,
)
from sawmill_service.pages.frame.formats import plain_number
from sawmill_service.pages.frame.languages import marked

GB = 10**9
KINDS = {
    RetentionKind.LOG_SCANS: marked("Scans of logs"),
    RetentionKind.PHANTOM_SCANS: marked("Scans of phantoms"),
    RetentionKind.RECONSTRUCTIONS: marked("Reconstructions"),
    RetentionKind.CALIBRATIONS: marked("Calibrations that were never active"),
    RetentionKind.DRIFTS: marked("Drift checks"),
    RetentionKind.INSPECTIONS: marked("Files that were looked into"),
    RetentionKind.EVENTS: marked("Events"),
}
REASONS = {
    StaysBecause.ACTIVE_CALIBRATION: marked("an active calibration, the one before it, or what they were made of"),
    StaysBecause.ONCE_ACTIVE: marked("was once active"),
    StaysBecause.REFERRED_TO: marked("a stored reconstruction or drift check used it"),
    StaysBecause.UNFINISHED_JOB: marked("a job that has not ended needs it"),
    StaysBecause.NEWEST: marked("the newest of its scanner"),
    StaysBecause.SCHEDULE: marked("a schedule goes by it"),
}


@dataclass
class RetentionForm:
    """Texts of the fields and what is wrong with them, by the names of the rules."""

    values: dict[str, str]
    errors: dict[str, str] = field(default_factory=dict)


def form_of(rules: RetentionRules, locale: Locale) -> RetentionForm:
    """Write rules into a form."""
    return RetentionForm({name: _written(name, value, locale) for name, value in rules.model_dump().items()})


def read_form(typed: Mapping[str, str], text: gettext.NullTranslations) -> tuple[RetentionForm, RetentionRules]:
    """Read typed texts as a form and as rules; a wrong text gives no rule, and an error in the form."""
    form = RetentionForm({name: typed.get(name, "").strip() for name in RetentionRules.model_fields})
    numbers: dict[str, int] = {}
    for name, written in form.values.items():
        if not written:
            continue
        number = _number(name, written)
        if number is None:
            sentence = (
                text.gettext("must be a number of GB, as in 500 or 1.5, not “%(value)s”")
                if name.endswith("_bytes")
                else text.gettext("must be a whole number of days from 1 to %(most)s, not “%(value)s”")
            )
            form.errors[name] = sentence % {"value": written, "most": LONGEST_DAYS}
        else:
            numbers[name] = number
    return form, RetentionRules.model_validate(numbers)


def _number(name: str, written: str) -> int | None:
    plain = plain_number(written)
    if name.endswith("_days"):
        days = int(plain) if re.fullmatch(r"[0-9]{1,6}", plain) else 0
        return days if 1 <= days <= LONGEST_DAYS else None
    size = round(float(plain) * GB) if re.fullmatch(r"[0-9]{1,9}(\.[0-9]{1,9})?", plain) else 0
    return size if 1 <= size <= LARGEST_BYTES else None


def _written(name: str, value: int | None, locale: Locale) -> str:
    if value is None:
        return ""
    exact: str = format_decimal(value / GB, "0.#########", locale=locale)
    return exact if name.endswith("_bytes") else str(value)
