"""The next step of a person with a scanner or a calibration, and the notice that a person took of a red one."""

from pydantic import Field

from sawmill_contracts.reasons import CodedReason
from sawmill_platform.contracts.base import Contract, Name, Time


class Acknowledgement(Contract):
    """Notice that a person took of an alarm: until its end the alarm is shown and asks for nothing."""

    until: Time = Field(description="End of the acknowledgement, RFC 3339.", examples=["2026-03-16T14:00:00Z"])
    by: str = Field(description="Name of the key of the person.", examples=["technician of line 2"])
    reason: Name = Field(description="Reason.", examples=["maintenance"])


class KnownRed(Acknowledgement):
    """Notice that a person took of a red scanner: it stays red, and asks for nothing until the end."""

    results: frozenset[str] = Field(
        description="Ids of the calibrations and drift checks that showed it red; another one is not covered.",
        examples=[["example"]],
    )


class NextStepAnswer(Contract):
    """The next step with a scanner or a calibration, the same that the pages and the report show."""

    tone: str = Field(description="Colour: `good`, `watch`, `bad` or `idle`.", examples=["bad"])
    word: str = Field(description="State of the scanner in a word, in English.", examples=["Out of tolerance"])
    headline: str = Field(
        description="English sentence on what is the matter, with the number and its limit.",
        examples=["Something has moved: 0.66 mm, and 0.50 mm is allowed."],
    )
    action: str = Field(description="English sentences on what to do, first thing first.", examples=["Scan again."])
    details: str = Field(description="English details for experts; may be empty.", examples=[""])
    button: str = Field(
        description="The button that the pages show: `accept`, `calibrate`, `scan-again`, `measure` (the phantom), "
        "`look` (at the report), `newest` (look at the newest calibration), `chosen` (look at the calibration that "
        "was chosen after this one) or `none`.",
        examples=["scan-again"],
    )
    reason: CodedReason = Field(description="The step with its code, its values and the reasons for it.")
    english: str | None = Field(
        None,
        description="Sentence of an answer that an earlier version stored without a code. Null: there is none.",
        examples=[None],
    )
    known: KnownRed | None = Field(
        None,
        description="Notice that a person took of all that shows the scanner red. Null: nobody did, it has ended, or "
        "the step is that of a calibration.",
        examples=[None],
    )
