"""Retention rules, and previews of what they would remove."""

from enum import StrEnum
from typing import Annotated, Any

from pydantic import Field

from sawmill_platform.contracts.base import LARGEST_NUMBER, Contract, Time
from sawmill_platform.contracts.given import Given

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


Days = Annotated[int, Field(ge=1, le=LONGEST_DAYS)]


def _days_of(thing: str, example: int, but: str = "") -> Any:  # noqa: ANN401 - a field
    sentence = f"Number of days after which {thing} is removed{but}. Null: no rule."
    return Field(None, description=sentence, examples=[example])


class RetentionRules(Contract):
    """Retention rules of each kind. A field that is null is no rule; without rules everything is kept."""

    log_scans_days: Days | None = _days_of("a scan that names no phantom", 14)
    phantom_scans_days: Days | None = _days_of("a scan of a phantom", 400)
    reconstructions_days: Days | None = _days_of("a reconstruction", 30)
    calibrations_days: Days | None = _days_of("a calibration that was never active", 400)
    drifts_days: Days | None = _days_of("a drift check", 400, "; its measurement is kept")
    inspections_days: Days | None = _days_of("an inspection", 30)
    events_days: Days | None = _days_of("an event", 90)

    def days(self) -> dict[RetentionKind, int]:
        """Return the days of the kinds that have a rule."""
        days = {kind: getattr(self, f"{kind.replace('-', '_')}_days") for kind in RetentionKind}
        return {kind: number for kind, number in days.items() if number is not None}


class RetentionRequest(RetentionRules, Given):
    """Rules to put into force, in place of all earlier ones."""

    remove_at_most: int = Field(
        0,
        ge=0,
        le=LARGEST_NUMBER,
        description="Number of objects that these rules may remove at once: the `number` of a preview that somebody "
        "has seen.",
    )


class RetentionQuery(RetentionRules, Given):
    """Rules of a preview; without any: the rules in force."""


class Removed(Contract):
    """Objects of one kind that were removed."""

    kind: RetentionKind = Field(description="Kind of the objects.", examples=["log-scans"])
    number: int = Field(description="Number of objects that were removed.", examples=[2000])


class Retention(Contract):
    """The rules in force."""

    rules: RetentionRules = Field(description="Rules in force.")
    changed_at: Time | None = Field(
        description="Time of the last change of the rules, RFC 3339, UTC. Null: there have been no rules yet."
    )
    changed_by: str | None = Field(
        description="Name of the key that changed the rules last. Null: there have been no rules yet.",
        examples=["the mill"],
    )
    days_wait_since: Time | None = Field(
        description="Time since which the rules wait for a person to put them into force again, RFC 3339, UTC: objects "
        "were last checked by age then, and not for 30 days after. Null: the rules do not wait.",
        examples=[None],
    )
    removed: list[Removed] = Field(description="Objects that rules have removed since the beginning, by kind.")


class KindPreview(Contract):
    """Objects of one kind that would be removed, and objects that would be kept although the rules reach them."""

    kind: RetentionKind = Field(description="Kind of the objects.", examples=["log-scans"])
    number: int = Field(description="Number of objects that would be removed.", examples=[2000])
    oldest_at: Time | None = Field(
        description="Time of the oldest object that would be removed, RFC 3339, UTC. Null: there is none.",
        examples=["2026-01-02T05:30:00Z"],
    )
    newest_at: Time | None = Field(
        description="Time of the newest object that would be removed, RFC 3339, UTC. Null: there is none.",
        examples=["2026-02-02T05:30:00Z"],
    )
    stays: int = Field(
        description="Number of objects that are kept although the rule reaches them: something needs them.",
        examples=[2],
    )


class RetentionPreview(Contract):
    """Objects that rules would remove until a time. Nothing has been removed."""

    at: Time = Field(
        description="Time until which the objects would be removed, RFC 3339, UTC: an hour after the request."
    )
    rules: RetentionRules = Field(description="Rules of the preview.")
    number: int = Field(
        description="Number of objects that would be removed. Send it as `remove_at_most` to put the rules into force.",
        examples=[2000],
    )
    kinds: list[KindPreview] = Field(description="Objects by kind; a kind without a rule has none.")
