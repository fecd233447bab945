"""Retention rules, what would be removed by them, and what is never removed."""

from collections.abc import Iterator
from enum import StrEnum
from typing import Annotated

from pydantic import Field

from sawmill_platform.contracts.base import LARGEST_NUMBER, Contract, Time
from sawmill_platform.contracts.given import Given
from sawmill_platform.contracts.retention import limits_of

# More than any disk holds, and exact as a number of JSON.
LARGEST_BYTES = 10**15
LONGEST_DAYS = 36_500


class RetentionKind(StrEnum):
    """Kinds that have rules of their own."""

    LOG_SCANS = "log-scans"
    PHANTOM_SCANS = "phantom-scans"
    RECONSTRUCTIONS = "reconstructions"
    CALIBRATIONS = "calibrations"
    DRIFTS = "drifts"
    INSPECTIONS = "inspections"
    EVENTS = "events"


class StaysBecause(StrEnum):
    """Reason why something is kept although a rule reaches it."""

    ACTIVE_CALIBRATION = "active-calibration"
    ONCE_ACTIVE = "once-active"
    REFERRED_TO = "referred-to"
    UNFINISHED_JOB = "unfinished-job"
    NEWEST = "newest"
    SCHEDULE = "schedule"


Days = Annotated[int, Field(ge=1, le=LONGEST_DAYS)]
Bytes = Annotated[int, Field(ge=1, le=LARGEST_BYTES)]


class RetentionRules(Contract):
    """Retention rules of each kind. A field that is null is no rule; without rules everything is kept."""

    log_scans_days: Days | None = Field(
        None,
        description="Number of days after which a scan that names no phantom is removed. Null: no rule.",
        examples=[14],
    )
    log_scans_bytes: Bytes | None = Field(
        None,
        description="Bytes that scans without a phantom may have together, uploads included; the oldest are removed "
        "first. Null: no rule.",
        examples=[2_000_000_000_000],
    )
    phantom_scans_days: Days | None = Field(
        None, description="Number of days after which a scan of a phantom is removed. Null: no rule.", examples=[400]
    )
    phantom_scans_bytes: Bytes | None = Field(
        None,
        description="Bytes that scans of phantoms may have together, uploads included; the oldest are removed "
        "first. Null: no rule.",
        examples=[500_000_000_000],
    )
    reconstructions_days: Days | None = Field(
        None, description="Number of days after which a reconstruction is removed. Null: no rule.", examples=[30]
    )
    reconstructions_bytes: Bytes | None = Field(
        None,
        description="Bytes that reconstructions may have together; the oldest are removed first. Null: no rule.",
        examples=[10**12],
    )
    calibrations_days: Days | None = Field(
        None,
        description="Number of days after which a calibration that was never active is removed. Null: no rule.",
        examples=[400],
    )
    calibrations_bytes: Bytes | None = Field(
        None,
        description="Bytes that calibrations may have together; the oldest are removed first. Null: no rule.",
        examples=[10**11],
    )
    drifts_days: Days | None = Field(
        None,
        description="Number of days after which a drift check is removed; its measurement is kept. Null: no rule.",
        examples=[400],
    )
    inspections_days: Days | None = Field(
        None, description="Number of days after which an inspection is removed. Null: no rule.", examples=[30]
    )
    events_days: Days | None = Field(
        None, description="Number of days after which an event is removed. Null: no rule.", examples=[90]
    )

    def kinds(self) -> Iterator[RetentionKind]:
        """Return the kinds that have a rule."""
        return (kind for kind in RetentionKind if any(limits_of(dict(self), kind)))


class RetentionAsk(RetentionRules, Given):
    """Rules to put into force, in place of all earlier ones."""

    remove_at_most: int = Field(
        0,
        ge=0,
        le=LARGEST_NUMBER,
        description="Number of objects that these rules may remove at once: the `number` of a preview that somebody "
        "has seen.",
        examples=[0],
    )


class RetentionQuery(RetentionRules, Given):
    """Rules of a preview; without any: the rules in force."""


class Removed(Contract):
    """Objects of one kind that were removed."""

    kind: RetentionKind = Field(description="Kind of the objects.", examples=["log-scans"])
    number: int = Field(description="Number of objects that were removed.", examples=[2000])
    freed_bytes: int = Field(
        description="Bytes that the removal freed on the disk. A file with several names counts when its last name "
        "is removed.",
        examples=[460_800_000_000],
    )


class Retention(Contract):
    """The rules in force."""

    rules: RetentionRules = Field(description="Rules in force.")
    changed_at: Time | None = Field(
        description="Time of the last change of the rules, RFC 3339, UTC. Null: there have been no rules yet.",
        examples=["2026-03-02T05:30:00Z"],
    )
    changed_by: str | None = Field(
        description="Name of the key that changed the rules last. Null: there have been no rules yet.",
        examples=["the mill"],
    )
    days_wait_since: Time | None = Field(
        description="Time since which rules of days wait for a person to put rules into force again, RFC 3339, UTC: "
        "objects were last checked by age then, and not for 30 days after. Null: the rules do not wait.",
        examples=[None],
    )
    removed: list[Removed] = Field(description="Objects that rules have removed since the beginning, by kind.")


class Going(Contract):
    """An object that would be removed."""

    id: str = Field(description="Id of the object; for an event, its number.", examples=["example"])
    created_at: Time = Field(description="Time of its creation, RFC 3339, UTC.", examples=["2026-03-02T05:30:00Z"])
    bytes: int | None = Field(description="Bytes of the object's files. Null: it has none.", examples=[230_400_000])
    by: str = Field(
        description="Rule that would remove the object: the field's name.",
        examples=["log_scans_days", "log_scans_bytes"],
    )


class Staying(Contract):
    """Objects that the rules reach and that are kept all the same."""

    because: StaysBecause = Field(
        description="`active-calibration`: a scanner's active calibration or the one before, or the scan of one of "
        "the two. `once-active`: a calibration that a scanner has used. `referred-to`: used by a stored "
        "reconstruction or drift check. `unfinished-job`: made or needed by a job that has not ended. `newest`: the "
        "newest of its sort of a scanner, and the calibration of its newest phantom scan. `schedule`: the next one "
        "that a schedule would use, or the last one that it used.",
        examples=["active-calibration"],
    )
    number: int = Field(description="Number of objects; one may be kept for several reasons.", examples=[2])
    first_ids: list[str] = Field(description="Ids of the oldest objects.", examples=[["example"]])


class KindPreview(Contract):
    """Objects of one kind that would be removed, and objects that would be kept although the rules reach them."""

    kind: RetentionKind = Field(description="Kind of the objects.", examples=["log-scans"])
    number: int = Field(description="Number of objects that would be removed.", examples=[2000])
    bytes: int | None = Field(
        description="Bytes of these objects' files; a file with several names counts with each. Null: no files, or "
        "no rule.",
        examples=[460_800_000_000],
    )
    oldest_at: Time | None = Field(
        description="Time at which the oldest object that would be removed was created, RFC 3339, UTC. Null: there "
        "is none.",
        examples=["2026-01-02T05:30:00Z"],
    )
    newest_at: Time | None = Field(
        description="Time at which the newest object that would be removed was created, RFC 3339, UTC. Null: there "
        "is none.",
        examples=["2026-02-02T05:30:00Z"],
    )
    first: list[Going] = Field(description="Objects that would be removed first: the oldest.")
    stays: list[Staying] = Field(description="Objects that are kept although the rules reach them, by reason.")


class RetentionPreview(Contract):
    """Objects that rules would remove until a time. Nothing has been removed."""

    at: Time = Field(
        description="Time until which the objects would be removed, RFC 3339, UTC: an hour after the request.",
        examples=["2026-03-02T05:30:00Z"],
    )
    rules: RetentionRules = Field(description="Rules of the preview.")
    number: int = Field(
        description="Number of objects that would be removed. Send it as `remove_at_most` to put the rules into force.",
        examples=[2000],
    )
    kinds: list[KindPreview] = Field(description="Objects by kind.")
