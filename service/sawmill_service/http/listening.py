"""Socket that the service listens on, opened before anything else is started."""

import errno
import socket
from ipaddress import IPv6Address, ip_address

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
        raise ListenError(_sentence(host, port, error)) from error
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


def _sentence(host: str, port: int, error: OSError) -> str:
    if error.errno == errno.EADDRINUSE:
        return (
            f"port {port} of {host} is taken: stop what listens there, or choose another port with --port or "
            "SAWMILL_PORT (0 takes a free one)"
        )
    return f"{host} with port {port} cannot be listened on: {error.strerror}"
