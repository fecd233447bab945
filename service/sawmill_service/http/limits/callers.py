"""Who sends a request, as limits count it."""

from ipaddress import IPv6Address, ip_address, ip_network

from starlette.types import Scope

from sawmill_store.acting import actor


def who(scope: Scope) -> str:
    """For whom a request counts: the key that it brought, or its client's network."""
    key_id = actor().key_id
    if key_id is not None:
        return f"key {key_id}"
    client: tuple[str, int] | None = scope.get("client")
    return network_of(client[0]) if client else "an unknown client"


def network_of(address: str) -> str:
    """An IPv4 address, or the /64 of an IPv6 address, which is what one subscriber has; other text as it is."""
    try:
        ip = ip_address(address.partition("%")[0])
    except ValueError:  # what a proxy has put there
        return address[:64]
    if not isinstance(ip, IPv6Address):
        return str(ip)
    return str(ip.ipv4_mapped or ip_network((ip, 64), strict=False))
