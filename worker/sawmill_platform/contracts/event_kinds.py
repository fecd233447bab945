"""Kinds of events: the words of the job service; other packages register theirs."""

from typing import Self

from sawmill_platform.contracts.registered import RegisteredWord


class EventKind(RegisteredWord):
    """Kind of an event."""

    is_decision: bool
    is_public: bool
    topic: str | None

    @classmethod
    def register(
        cls, word: str, *, is_decision: bool = False, is_public: bool = True, topic: str | None = None
    ) -> Self:
        """Add a kind of event.

        Parameters
        ----------
        word
            Name of the kind.
        is_decision
            True if somebody decides it: the audit keeps such events for ever, with who decided and from where.
        is_public
            True if the feed and webhooks publish it.
        topic
            The heading under which the history of a group keeps it; null: no history does. The ends of jobs have the
            topic of their kind of job.
        """
        kind = cls._add(word)
        kind.is_decision, kind.is_public, kind.topic = is_decision, is_public, topic
        return kind

    @classmethod
    def decisions(cls) -> tuple[Self, ...]:
        """Return the kinds that the audit keeps."""
        return tuple(kind for kind in cls.all() if kind.is_decision)

    @classmethod
    def published(cls) -> tuple[Self, ...]:
        """Return the kinds that the feed and webhooks publish."""
        return tuple(kind for kind in cls.all() if kind.is_public)

    @classmethod
    def unpublished(cls) -> tuple[Self, ...]:
        """Return the kinds that neither the feed nor webhooks publish."""
        return tuple(kind for kind in cls.all() if not kind.is_public)


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
JOB_CANCELLED = EventKind.register("job-cancelled", is_decision=True, is_public=False)
LOGGED_IN = EventKind.register("logged-in", is_decision=True, is_public=False)
LOGGED_OUT = EventKind.register("logged-out", is_decision=True, is_public=False)
CLOCK_STEPPED = EventKind.register("clock-stepped")
CLOCK_OFF = EventKind.register("clock-off")
RESTORED = EventKind.register("restored")

JOB_ENDS = frozenset({SUCCEEDED, FAILED, CANCELLED})
"""Kinds of events that end a job."""
