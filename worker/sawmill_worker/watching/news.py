"""What a watcher says: each event once, each trouble when it begins and when it is over."""

import structlog


class News:
    """Writes the log.

    Troubles are known by what they are about: the service, a folder, a file. One that lasts is written once, and again
    when its reason changes.
    """

    def __init__(self) -> None:
        self._log = structlog.get_logger()
        self._troubles: dict[str, str] = {}

    def event(self, name: str, **details: object) -> None:
        """Something has happened."""
        self._log.info(name, **details)

    def warn(self, name: str, **details: object) -> None:
        """Something has happened that somebody should look at."""
        self._log.warning(name, **details)

    def trouble(self, about: str, code: str, reason: str, **details: object) -> None:
        """Something waits; `code` tells one reason from another, whose sentences may count seconds or bytes."""
        if self._troubles.get(about) != code:
            self._troubles[about] = code
            self._log.warning("waits", about=about, code=code, reason=reason, **details)

    def over(self, about: str) -> None:
        """It waits no longer."""
        if self._troubles.pop(about, None) is not None:
            self._log.info("goes-on", about=about)

    def forget(self, about: str) -> None:
        """What it was about is gone."""
        self._troubles.pop(about, None)

    @property
    def troubles(self) -> dict[str, str]:
        """What waits now, with the code of its reason."""
        return dict(self._troubles)
