"""Socket that the service listens on, opened before anything else is started, and the number of its connections."""

import errno
import logging
import resource
import socket
from ipaddress import IPv6Address, ip_address

import structlog

_UNACKNOWLEDGED_MS = 60_000
_FIRST_PROBE_S = 60


class ListenError(Exception):
    """Refusal to listen on an address, with a sentence that names a right one."""


def listen(host: str, port: int, *, guarded: bool) -> socket.socket:
    """Listen on an address; beyond loopback only if a key guards the service.

    The address that `host` resolves to counts, not its text: a name may resolve to any address.

    Parameters
    ----------
    host
        Address or name; one with a colon is an IPv6 address.
    port
        Port; 0 takes a free one.
    guarded
        Whether there is a key or a token, without which requests are refused.

    Raises
    ------
    ListenError
        The port is taken, the address is not this machine's, or it is beyond loopback and nothing guards it.
    """
    listening = socket.socket(socket.AF_INET6 if ":" in host else socket.AF_INET)
    try:
        listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        # Connections inherit it. Without it an answer's second part waits until the client has acknowledged the first,
        # and clients acknowledge after 40 ms: asyncio sets it on sockets of a named protocol alone.
        listening.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        # Connections whose client has silently gone end, whether bytes are being sent to it or not.
        listening.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, _UNACKNOWLEDGED_MS)
        listening.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
        listening.setsockopt(socket.IPPROTO_TCP, socket.TCP_KEEPIDLE, _FIRST_PROBE_S)
        listening.bind((host, port))
        _check_guarded(host, listening.getsockname()[0], guarded=guarded)
        listening.listen()
    except OSError as error:
        listening.close()
        if error.errno == errno.EADDRINUSE:
            raise ListenError(
                f"port {port} of {host} is taken: stop what listens there, or choose another port with --port or "
                "SAWMILL_PORT (0 takes a free one)"
            ) from error
        raise ListenError(f"{host} with port {port} cannot be listened on: {error.strerror}") from error
    except ListenError:
        listening.close()
        raise
    return listening


def is_loopback(address: str) -> bool:
    """Return whether an IP address is this machine's own, which other machines cannot reach."""
    ip = ip_address(address)
    return ((ip.ipv4_mapped if isinstance(ip, IPv6Address) else None) or ip).is_loopback


def _check_guarded(host: str, address: str, *, guarded: bool) -> None:
    if not guarded and not is_loopback(address):
        raise ListenError(
            f"{host} can be reached from other machines, so requests must bring a key: make one with sawmill key "
            "create --name NAME --scope admin, set SAWMILL_TOKEN (at least 32 characters) or SAWMILL_TOKEN_FILE, or "
            "listen on 127.0.0.1"
        )


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
