"""The number of files that the process may open, each connection being one."""

import resource

from sawmill_service.listening import ListenError

# A connection, and the file that it sends or fetches.
_PER_CONNECTION = 2
# The database's connections, one for each thread of the API, the pipes to the workers, and what Python has open.
_OTHERS = 256


def files_needed(connections: int) -> int:
    """The number of files that the process opens for this number of connections."""
    return _PER_CONNECTION * connections + _OTHERS


def open_files_for(connections: int) -> None:
    """Raise the limit of this process as far as its connections need it; its children inherit that.

    Raises
    ------
    ListenError
        The system allows fewer.
    """
    needed = files_needed(connections)
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if soft != resource.RLIM_INFINITY and soft < needed:
        if hard != resource.RLIM_INFINITY and hard < needed:
            raise ListenError(
                f"{connections} connections need {needed} open files, and the system allows {hard}: raise its limit "
                f"(ulimit -n), or set SAWMILL_MAX_CONNECTIONS to at most {max(1, (hard - _OTHERS) // _PER_CONNECTION)}"
            )
        resource.setrlimit(resource.RLIMIT_NOFILE, (needed, hard))
