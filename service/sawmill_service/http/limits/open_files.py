"""Number of files that the process may open; each connection is one."""

import logging
import resource

import structlog

# A connection, and the file that it sends or fetches.
_PER_CONNECTION = 2
# The database's connections, one for each thread of the API, the pipes to the workers, and what Python has open.
_OTHERS = 256
_SAME_LINE_S = 60.0


def files_needed(connections: int) -> int:
    """Return the number of files that the process opens for this number of connections."""
    return _PER_CONNECTION * connections + _OTHERS


def possible_connections(connections: int) -> int:
    """Raise the process's limit of open files as far as its connections need it; its children inherit that.

    Returns
    -------
    int
        `connections`, or fewer where the system allows fewer files.
    """
    needed = files_needed(connections)
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if hard != resource.RLIM_INFINITY:
        connections = min(connections, max(1, (hard - _OTHERS) // _PER_CONNECTION))
        needed = min(needed, hard)
    if soft != resource.RLIM_INFINITY and soft < needed:
        resource.setrlimit(resource.RLIMIT_NOFILE, (needed, hard))
    return connections


def connections_of(most: int) -> int:
    """Return the number of connections that the service serves, and warn where the system allows fewer than `most`."""
    possible = possible_connections(most)
    if possible < most:
        structlog.get_logger().warning(
            "fewer-connections",
            connections=possible,
            reason=f"{most} connections need {files_needed(most)} open files, and the system allows fewer: raise its "
            f"limit (ulimit -n), or set SAWMILL_MAX_CONNECTIONS to {possible}",
        )
    return possible


class RefusedAccepts(logging.Filter):
    """A filter that passes one line a minute about connections that the system does not let the service accept.

    asyncio tries again each second, as many times as it accepts at once, and logs a traceback each time.
    """

    def __init__(self) -> None:
        super().__init__()
        self._next = 0.0

    def filter(self, record: logging.LogRecord) -> bool:
        """Return whether a line is logged."""
        if "accept() out of system resource" not in record.msg and "_start_serving" not in record.msg:
            return True
        if record.created < self._next:
            return False
        self._next = record.created + _SAME_LINE_S
        return True


def log_refused_accepts_rarely() -> None:
    """Keep connections that nobody uses from filling the log with those that cannot be accepted."""
    logging.getLogger("asyncio").addFilter(RefusedAccepts())
