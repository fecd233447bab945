"""Kinds of events: the words of the job service; other packages register theirs."""

from typing import Any, Self

from pydantic import GetJsonSchemaHandler
from pydantic_core import CoreSchema

from sawmill_platform.contracts.jobs import RegisteredWord


class EventType(RegisteredWord):
    """Kind of an event."""

    # True if somebody decides it: the audit keeps such events for ever, with who decided and from where.
    is_decision: bool
    is_public: bool  # true if the feed and webhooks publish it
    # Heading under which the history of a group keeps it; the ends of jobs have the topic of their kind of job.
    topic: str | None
    about: str  # explanation for the public document, without a full stop, if the word does not say it

    @classmethod
    def register(
        cls, word: str, about: str = "", *, is_decision: bool = False, is_public: bool = True, topic: str | None = None
    ) -> Self:
        """Add a kind of event."""
        return cls._add(word, about=about, is_decision=is_decision, is_public=is_public, topic=topic)

    @classmethod
    def __get_pydantic_json_schema__(cls, schema: CoreSchema, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        """List the words as an enumeration, with the explanations of some."""
        explained = "; ".join(f"`{kind}`: {kind.about}" for kind in cls.all() if kind.about)
        return super().__get_pydantic_json_schema__(schema, handler) | {"description": f"{cls.__doc__} {explained}."}

    @classmethod
    def published(cls) -> tuple[Self, ...]:
        """Return the kinds that the feed and webhooks publish."""
        return tuple(kind for kind in cls.all() if kind.is_public)


QUEUED = EventType.register("queued")
STARTED = EventType.register("started")
SUCCEEDED = EventType.register("succeeded")
FAILED = EventType.register("failed")
LOST = EventType.register("lost", "the attempt ended without an answer")
POSTPONED = EventType.register("postponed", "an outage ended the attempt, which is no loss")
GIVEN_BACK = EventType.register("given-back", "the worker of the attempt stopped, or another job went first")
CANCEL_REQUESTED = EventType.register("cancel-requested", "the worker of the job was requested to stop")
CANCELLED = EventType.register("cancelled")
UPLOAD_CREATED = EventType.register("upload-created")
UPLOAD_COMPLETE = EventType.register("upload-complete")
UPLOAD_USED = EventType.register("upload-used")
UPLOAD_DELETED = EventType.register("upload-deleted")
KEY_CREATED = EventType.register("key-created", is_decision=True)
KEY_ROTATED = EventType.register("key-rotated", is_decision=True)
KEY_REVOKED = EventType.register("key-revoked", is_decision=True)
WEBHOOK_CREATED = EventType.register("webhook-created", is_decision=True)
WEBHOOK_CHANGED = EventType.register("webhook-changed", is_decision=True)
WEBHOOK_ROTATED = EventType.register("webhook-rotated", is_decision=True)
WEBHOOK_TESTED = EventType.register("webhook-tested", is_decision=True)
WEBHOOK_PAUSED = EventType.register("webhook-paused", "nothing is sent to the webhook any more, for `reason`")
WEBHOOK_DELETED = EventType.register("webhook-deleted", is_decision=True)
RETENTION_CHANGED = EventType.register("retention-changed", is_decision=True)
RETENTION_REMOVED = EventType.register(
    "retention-removed", "the rules of `/v1/retention` removed objects of the kind `subject_id`"
)
JOB_CANCELLED = EventType.register("job-cancelled", is_decision=True, is_public=False)
LOGGED_IN = EventType.register("logged-in", is_decision=True, is_public=False)
LOGGED_OUT = EventType.register("logged-out", is_decision=True, is_public=False)
CLOCK_STEPPED = EventType.register("clock-stepped", "the service followed a step of its machine's clock")
CLOCK_OFF = EventType.register("clock-off", "the worker's clock differs from the service's by more than 5 s")
RESTORED = EventType.register("restored", "the database lacks what happened after the backup that was restored")

JOB_ENDS = frozenset({SUCCEEDED, FAILED, CANCELLED})  # kinds of events that end a job
