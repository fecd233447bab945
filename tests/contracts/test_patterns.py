"""The contract's regular expressions fit what is read, and the conditions between fields what is refused."""

import re
import sys
import unicodedata
from datetime import UTC, datetime

import pytest
from cronsim import CronSim
from jsonschema import Draft202012Validator
from pydantic import TypeAdapter, ValidationError
from results import THETA

from sawmill_contracts.phantoms import PhantomRequest
from sawmill_contracts.reconstructions import ReconstructionRequest
from sawmill_contracts.row_ranges import STEPPED_ROWS, SteppedRows
from sawmill_contracts.schedules import ScheduleRequest
from sawmill_platform.contracts import patterns
from sawmill_platform.contracts.base import Name
from sawmill_platform.contracts.given import hidden_characters
from sawmill_platform.contracts.keys import KeyRequest

NOW = datetime(2026, 3, 2, tzinfo=UTC)
DISC = {"name": "disc", "shapes": [{"kind": "disc", "center_mm": [0, 0], "radius_mm": 50}]}


def taken(contract, value):
    try:
        TypeAdapter(contract).validate_python(value)
    except ValidationError:
        return False
    return True


def test_cron_expressions_that_are_read_fit_the_pattern_and_those_that_are_refused_do_not():
    read = ("30 5 * * 1-6", "*/10 6,18 1-7/2 JAN MON-FRI", "0 0 L * *", "0 0 LW 12 *", "5/15 23 31 * 7")
    for cron in (*read, "0 0 * * 5L,1#2"):
        assert next(CronSim(cron, NOW)), cron
        assert re.search(patterns.CRON, cron), cron
    for cron in ("60 * * * *", "* 24 * * *", "* * 0 * *", "* * * 13 *", "* * * * 8", "* * * *", "a"):
        assert re.search(patterns.CRON, cron) is None, cron


def test_rows_and_names_that_fit_their_patterns_are_read():
    assert taken(SteppedRows, "0:2500:10")
    assert re.search(STEPPED_ROWS, "0:2500:10")
    for text in ("3", "a:b", "1:0", "0:8:0", "0:16\n"):
        assert not taken(SteppedRows, text), text
        assert re.fullmatch(STEPPED_ROWS, text) is None, text
    names = {"Line 2": True, "Säge": True, "Mätäsvaara, linja 2 (å)": True, "": False, "  ": False, "a\nb": False}
    for name, fits in {**names, "a\u202eb": False, "a\u200bb": False, "\u200eab": False, "a\u061cb": False}.items():
        assert (re.fullmatch(patterns.NAME, name) is not None) is fits, name
        assert not fits or taken(Name, name)


def test_every_format_character_of_unicode_is_refused_in_a_text():
    format_characters = [chr(code) for code in range(sys.maxunicode + 1) if unicodedata.category(chr(code)) == "Cf"]
    assert len(format_characters) > 160
    sent = {f"{ord(letter):x}": f"a{letter}b" for letter in format_characters}
    assert len(list(hidden_characters(sent))) == len(sent)
    shown = {"finnish": "Höyläämö Åbo", "russian": "Лесопилка", "arabic": "منشرة", "wide": "製材所", "emoji": "🪵"}
    assert list(hidden_characters(shown)) == []


@pytest.mark.parametrize(
    ("contract", "given"),
    [
        (ReconstructionRequest, {}),
        (ReconstructionRequest, {"alpha": 4.0}),
        (ReconstructionRequest, {"alpha": 4.0, "method": "tikhonov"}),
        (ReconstructionRequest, {"alpha": 1e-10, "method": "tikhonov"}),
        (ReconstructionRequest, {"alpha": None, "non_negative": True}),
        (ReconstructionRequest, {"alpha": 4.0, "method": "tikhonov", "alpha_rule": "gcv"}),
        (ReconstructionRequest, {"filter": "hamming"}),
        (ReconstructionRequest, {"filter": "hamming", "method": "cauchy_map"}),
        (ReconstructionRequest, {"non_negative": False, "method": "cauchy_map"}),
        (ReconstructionRequest, {"preset": "paper", "method": "cauchy_map", "sigma": None}),
        (ReconstructionRequest, {"preset": "paper", "method": "cauchy_map", "sigma": 0.1}),
        (ReconstructionRequest, {"theta": THETA}),
        (ReconstructionRequest, {"theta": THETA, "calibration_id": "example"}),
        (ReconstructionRequest, {"theta": None, "calibration_id": "example"}),
        (ReconstructionRequest, {"theta": THETA, "rotation": "reversed"}),
        (ReconstructionRequest, {"rotation": "reversed"}),
        (ReconstructionRequest, {"field_mm": 1e-3}),
        (KeyRequest, {"name": "wall", "scope": "read", "display": True}),
        (KeyRequest, {"name": "wall", "scope": "admin", "display": True}),
        (PhantomRequest, DISC),
        (PhantomRequest, DISC | {"follows": "a"}),
        (ScheduleRequest, {"scanner_id": "example", "cron": "30 5 * * 1-6"}),
        (ScheduleRequest, {"scanner_id": "example", "cron": "30 5 * * 1-6", "kind": "check-drift"}),
        (ScheduleRequest, {"scanner_id": "example", "cron": "30 5 * * 1-6", "on_pass": "activate"}),
        (ScheduleRequest, {"scanner_id": "example", "cron": "0 5 * * *", "kind": "check-drift", "on_pass": "activate"}),
    ],
)
def test_the_schema_takes_what_the_contract_takes(contract, given):
    whole = ({"scan_id": "example"} if contract is ReconstructionRequest else {}) | given
    assert Draft202012Validator(contract.model_json_schema()).is_valid(whole) is taken(contract, whole)
