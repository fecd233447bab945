"""How long what is stored is kept, what would go by such rules, and what never goes."""

from collections.abc import Iterator
from enum import StrEnum
from typing import Annotated, Literal

from pydantic import Field

from sawmill_platform.contracts.base import LARGEST_NUMBER, Contract, Time
from sawmill_platform.contracts.given import Given

# Beyond what any disk holds, and exact as a number of JSON.
LARGEST_BYTES = 10**15
LONGEST_DAYS = 36_500


class RetentionKind(StrEnum):
    """What has rules of its own."""

    LOG_SCANS = "log-scans"
    PHANTOM_SCANS = "phantom-scans"
    RECONSTRUCTIONS = "reconstructions"
    CALIBRATIONS = "calibrations"
    DRIFTS = "drifts"
    INSPECTIONS = "inspections"
    EVENTS = "events"


class StaysBecause(StrEnum):
    """Why something that is beyond the rules stays."""

    ACTIVE_CALIBRATION = "active-calibration"
    ONCE_ACTIVE = "once-active"
    REFERRED_TO = "referred-to"
    UNFINISHED_JOB = "unfinished-job"
    NEWEST = "newest"
    SCHEDULE = "schedule"


Days = Annotated[int, Field(ge=1, le=LONGEST_DAYS)]
Bytes = Annotated[int, Field(ge=1, le=LARGEST_BYTES)]


class RetentionRules(Contract):
    """How long each kind is kept. A field that is null is no rule; without rules everything stays."""

    log_scans_days: Days | None = Field(
        None, description="Number of days after which a scan that names no phantom goes.", examples=[14]
    )
    log_scans_bytes: Bytes | None = Field(
        None,
        description="Bytes that scans without a phantom may have together, uploads included; the oldest go first.",
        examples=[2_000_000_000_000],
    )
    phantom_scans_days: Days | None = Field(
        None, description="Number of days after which a scan of a phantom goes.", examples=[400]
    )
    phantom_scans_bytes: Bytes | None = Field(
        None,
        description="Bytes that scans of phantoms may have together, uploads included; the oldest go first.",
        examples=[500_000_000_000],
    )
    reconstructions_days: Days | None = Field(
        None, description="Number of days after which a reconstruction goes.", examples=[30]
    )
    reconstructions_bytes: Bytes | None = Field(
        None, description="Bytes that reconstructions may have together; the oldest go first.", examples=[10**12]
    )
    calibrations_days: Days | None = Field(
        None, description="Number of days after which a calibration that was never active goes.", examples=[400]
    )
    calibrations_bytes: Bytes | None = Field(
        None, description="Bytes that calibrations may have together; the oldest go first.", examples=[10**11]
    )
    drifts_days: Days | None = Field(
        None, description="Number of days after which a drift check goes; what it measured stays.", examples=[400]
    )
    inspections_days: Days | None = Field(
        None, description="Number of days after which an inspection goes.", examples=[30]
    )
    events_days: Days | None = Field(None, description="Number of days after which an event goes.", examples=[90])

    def days_of(self, kind: RetentionKind) -> int | None:
        """How long a kind is kept; None: for good."""
        days: int | None = getattr(self, rule_name(kind, "days"))
        return days

    def bytes_of(self, kind: RetentionKind) -> int | None:
        """How much of a kind is kept; None: all of it, or it has no files."""
        most: int | None = getattr(self, rule_name(kind, "bytes"), None)
        return most

    def kinds(self) -> Iterator[RetentionKind]:
        """Those that have a rule."""
        return (kind for kind in RetentionKind if self.days_of(kind) is not None or self.bytes_of(kind) is not None)


def rule_name(kind: RetentionKind, unit: Literal["days", "bytes"]) -> str:
    """The field that has a kind's rule."""
    return f"{kind.value.replace('-', '_')}_{unit}"


class RetentionAsk(RetentionRules, Given):
    """Rules that are to hold from now on, in place of all earlier ones."""

    remove_at_most: int = Field(
        0,
        ge=0,
        le=LARGEST_NUMBER,
        description="How many things these rules may remove at once: the `number` of a preview that somebody has seen.",
        examples=[0],
    )


class RetentionQuery(RetentionRules, Given):
    """Rules that are tried; none of them: those in force."""


class Removed(Contract):
    """What went of one kind."""

    kind: RetentionKind = Field(description="What it was.", examples=["log-scans"])
    number: int = Field(description="Number of them that went.", examples=[2000])
    freed_bytes: int = Field(
        description="Bytes that this freed on the disk. Of files with several names, those of the last name alone.",
        examples=[460_800_000_000],
    )


class Retention(Contract):
    """The rules in force."""

    rules: RetentionRules = Field(description="Those in force.")
    changed_at: Time | None = Field(
        description="When they were changed last, RFC 3339, UTC. Null: there were none yet.",
        examples=["2026-03-02T05:30:00Z"],
    )
    changed_by: str | None = Field(
        description="Who changed them last: the name of the key. Null: there were none yet.", examples=["the mill"]
    )
    days_wait_since: Time | None = Field(
        description="Since when rules of days wait for a person to put rules into force anew, RFC 3339, UTC: days were "
        "counted then, and not for 30 days after it. Null: they do not wait.",
        examples=[None],
    )
    removed: list[Removed] = Field(description="What has gone by rules since the beginning, by kind.")


class Going(Contract):
    """One thing that would go."""

    id: str = Field(description="Its id; of an event, its number.", examples=["example"])
    created_at: Time = Field(description="When it came, RFC 3339, UTC.", examples=["2026-03-02T05:30:00Z"])
    bytes: int | None = Field(description="Bytes of its files. Null: it has none.", examples=[230_400_000])
    by: str = Field(
        description="The rule by which it goes: the field's name.", examples=["log_scans_days", "log_scans_bytes"]
    )


class Staying(Contract):
    """What the rules reach, and what stays all the same."""

    because: StaysBecause = Field(
        description="`active-calibration`: it is a scanner's active calibration or the one before, or the scan that "
        "one of these was made of. `once-active`: a scanner has used this calibration. `referred-to`: a "
        "reconstruction or a drift check that is stored used it. `unfinished-job`: a job that has not ended makes it "
        "or needs it. `newest`: the newest of its sort of a scanner, and the calibration of its newest phantom scan. "
        "`schedule`: a schedule would use it next, or knows by it what it has used.",
        examples=["active-calibration"],
    )
    number: int = Field(description="Number of them; one may stay for several reasons.", examples=[2])
    first_ids: list[str] = Field(description="Ids of the oldest.", examples=[["example"]])


class KindPreview(Contract):
    """What would go of one kind, and what would stay although the rules reach it."""

    kind: RetentionKind = Field(description="What it is.", examples=["log-scans"])
    number: int = Field(description="Number of them that would go.", examples=[2000])
    bytes: int | None = Field(
        description="Bytes of their files; those with several names count with each. Null: it has none, or no rule.",
        examples=[460_800_000_000],
    )
    oldest_at: Time | None = Field(
        description="When the oldest that would go came, RFC 3339, UTC. Null: none would.",
        examples=["2026-01-02T05:30:00Z"],
    )
    newest_at: Time | None = Field(
        description="When the newest that would go came, RFC 3339, UTC. Null: none would.",
        examples=["2026-02-02T05:30:00Z"],
    )
    first: list[Going] = Field(description="The first that would go: the oldest.")
    stays: list[Staying] = Field(description="What stays although the rules reach it, by reason.")


class RetentionPreview(Contract):
    """What would go by rules until a time. Nothing has gone."""

    at: Time = Field(
        description="The time until which it would go, RFC 3339, UTC: an hour after the question.",
        examples=["2026-03-02T05:30:00Z"],
    )
    rules: RetentionRules = Field(description="The rules by which it would go.")
    number: int = Field(
        description="Number of things that would go. Send it as `remove_at_most` to put the rules into force.",
        examples=[2000],
    )
    kinds: list[KindPreview] = Field(description="By kind.")
