"""Log of a watcher: each event once, each trouble when it begins and when it is over."""

import structlog


class News:
    """Writer of the log.

    A trouble is identified by its subject: the service, a folder or a file. A lasting trouble is written once, and
    again when the reason changes.
    """

    def __init__(self) -> None:
        self._log = structlog.get_logger()
        self._troubles: dict[str, str] = {}

    def event(self, name: str, **details: object) -> None:
        """Log an event."""
        self._log.info(name, **details)

    def warn(self, name: str, **details: object) -> None:
        """Log an event that a person should check."""
        self._log.warning(name, **details)

    def trouble(self, about: str, code: str, reason: str, **details: object) -> None:
        """Log that a subject waits; `code` identifies the reason, whose sentence may contain seconds or bytes."""
        if self._troubles.get(about) != code:
            self._troubles[about] = code
            self._log.warning("waits", about=about, code=code, reason=reason, **details)

    def over(self, about: str) -> None:
        """Log that the subject waits no longer."""
        if self._troubles.pop(about, None) is not None:
            self._log.info("goes-on", about=about)

    def forget(self, about: str) -> None:
        """Forget a subject that is gone."""
        self._troubles.pop(about, None)

    @property
    def troubles(self) -> dict[str, str]:
        """Subjects that wait now, with the codes of the reasons."""
        return dict(self._troubles)
