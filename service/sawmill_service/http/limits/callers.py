"""Names of the senders of requests, by which limits count."""

from ipaddress import IPv6Address, ip_address, ip_network

from starlette.types import Scope

from sawmill_platform.acting import actor


def who(scope: Scope) -> str:
    """Return the name under which a request is counted: the key that it brought, or the client's network."""
    key_id = actor().key_id
    if key_id is not None:
        return f"key {key_id}"
    client: tuple[str, int] | None = scope.get("client")
    return network_of(client[0]) if client else "an unknown client"


def network_of(address: str) -> str:
    """Return an IPv4 address, or the /64 of an IPv6 address, which one subscriber has; any other text unchanged."""
    try:
        ip = ip_address(address.partition("%")[0])
    except ValueError:  # a text that a proxy has put there
        return address[:64]
    if not isinstance(ip, IPv6Address):
        return str(ip)
    return str(ip.ipv4_mapped or ip_network((ip, 64), strict=False))
