"""Kinds of events: the words of the job service; other packages register theirs."""

from typing import Self

from sawmill_platform.contracts.registered import RegisteredWord


class EventKind(RegisteredWord):
    """What happened."""

    is_decision: bool

    @classmethod
    def register(cls, word: str, *, is_decision: bool = False) -> Self:
        """Add a kind of event; the audit keeps decisions, with who took them, for ever."""
        kind = cls._add(word)
        kind.is_decision = is_decision
        return kind

    @classmethod
    def decisions(cls) -> tuple[Self, ...]:
        """Return the kinds that the audit keeps."""
        return tuple(kind for kind in cls.all() if kind.is_decision)


QUEUED = EventKind.register("queued")
STARTED = EventKind.register("started")
SUCCEEDED = EventKind.register("succeeded")
FAILED = EventKind.register("failed")
LOST = EventKind.register("lost")
PUT_OFF = EventKind.register("put-off")
GIVEN_BACK = EventKind.register("given-back")
CANCEL_REQUESTED = EventKind.register("cancel-requested")
CANCELLED = EventKind.register("cancelled")
UPLOAD_CREATED = EventKind.register("upload-created")
UPLOAD_COMPLETE = EventKind.register("upload-complete")
UPLOAD_USED = EventKind.register("upload-used")
UPLOAD_DELETED = EventKind.register("upload-deleted")
KEY_CREATED = EventKind.register("key-created", is_decision=True)
KEY_ROTATED = EventKind.register("key-rotated", is_decision=True)
KEY_REVOKED = EventKind.register("key-revoked", is_decision=True)
WEBHOOK_CREATED = EventKind.register("webhook-created", is_decision=True)
WEBHOOK_CHANGED = EventKind.register("webhook-changed", is_decision=True)
WEBHOOK_ROTATED = EventKind.register("webhook-rotated", is_decision=True)
WEBHOOK_TESTED = EventKind.register("webhook-tested", is_decision=True)
WEBHOOK_PAUSED = EventKind.register("webhook-paused")
WEBHOOK_DELETED = EventKind.register("webhook-deleted", is_decision=True)
RETENTION_CHANGED = EventKind.register("retention-changed", is_decision=True)
RETENTION_REMOVED = EventKind.register("retention-removed")
JOB_CANCELLED = EventKind.register("job-cancelled", is_decision=True)
LOGGED_IN = EventKind.register("logged-in", is_decision=True)
LOGGED_OUT = EventKind.register("logged-out", is_decision=True)
CLOCK_STEPPED = EventKind.register("clock-stepped")
CLOCK_OFF = EventKind.register("clock-off")
RESTORED = EventKind.register("restored")

JOB_ENDS = frozenset({SUCCEEDED, FAILED, CANCELLED})
"""How jobs end."""
