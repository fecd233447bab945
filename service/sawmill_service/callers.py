"""Who sends a request, as limits count it."""

from ipaddress import IPv6Address, ip_address, ip_network

from starlette.types import Scope


def who(scope: Scope) -> str:
    """For whom a request counts: its client's network."""
    client: tuple[str, int] | None = scope.get("client")
    return network_of(client[0]) if client else "unknown"


def network_of(address: str) -> str:
    """An IPv4 address, or the /64 of an IPv6 address, which is what one subscriber has; other text as it is."""
    try:
        ip = ip_address(address.partition("%")[0])
    except ValueError:  # what a proxy has put there
        return address[:64]
    if not isinstance(ip, IPv6Address):
        return str(ip)
    return str(ip.ipv4_mapped or ip_network((ip, 64), strict=False))
