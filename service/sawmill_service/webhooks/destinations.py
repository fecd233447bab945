"""Allowed destinations of webhooks: the names and networks of SAWMILL_WEBHOOK_DESTINATIONS, and no others.

A listed name is allowed. The addresses to which the name resolves are checked in each attempt: addresses that are not
public (loopback, the mill's own networks, link-local ones with the metadata of clouds) must lie in a listed network
too, so that the owner of a name cannot lead the service to addresses that only this machine reaches.
"""

import re
from collections.abc import Iterable
from ipaddress import IPv4Address, IPv4Network, IPv6Address, IPv6Network, ip_address, ip_network

from sawmill_platform.contracts.patterns import PORT
from sawmill_platform.contracts.webhooks import Destination

SETTING = "SAWMILL_WEBHOOK_DESTINATIONS"
_NAME = re.compile(rf"([A-Za-z0-9_-]+(?:\.[A-Za-z0-9_-]+)*)\.?(?::({PORT}))?")
STANDARD_PORTS = (443, 80)
# All public addresses of IPv6 (RFC 4291, 2.4); site-local ones, NAT64 and other notations of IPv4 lie outside.
_GLOBAL_UNICAST = IPv6Network("2000::/3")
# Networks that some versions of `is_global` take for public: IPv6 that embeds an IPv4 address behind an unknown gateway
# (6to4, its relays, Teredo: RFC 3056, 7526, 4380), protocol assignments (6890), documentation (9637).
_NOT_PUBLIC = tuple(map(ip_network, ("2002::/16", "192.88.99.0/24", "2001::/32", "192.0.0.0/24", "3fff::/20")))

Address = IPv4Address | IPv6Address
Network = IPv4Network | IPv6Network


class RefusedDestinationError(Exception):
    """A destination to which nothing is sent; the message says what to set."""


def check_entry(text: str) -> str:
    """Check an entry of the setting, and return it unchanged."""
    if _network(text) is not None:
        return text
    match = _NAME.fullmatch(text)
    # A malformed IPv4 address would be taken for a name.
    if match is None or re.fullmatch(r"[0-9.]+", match[1]):
        raise ValueError(
            f"must be names or networks, as in alarms.mill.example, mes.mill.example:8443 or 10.20.0.0/16, not {text!r}"
        )
    return text


def _network(text: str) -> Network | None:
    """Parse a network, or an address as a network of one; None: the text is neither."""
    try:
        return ip_network(text)
    except ValueError:
        return None


class AllowedDestinations:
    """Entries of the setting."""

    def __init__(self, entries: Iterable[str]) -> None:
        self._names: set[tuple[str, int]] = set()
        self._networks: list[Network] = []
        for text in entries:
            network = _network(text)
            if network is not None:
                self._networks.append(network)
            elif match := _NAME.fullmatch(text):
                ports = [int(match[2])] if match[2] else STANDARD_PORTS
                self._names.update((match[1].lower(), port) for port in ports)

    def __bool__(self) -> bool:
        return bool(self._names or self._networks)

    def check(self, destination: Destination) -> None:
        """Refuse a destination that no entry allows; nothing is looked up."""
        if not self:
            msg = f'nothing is sent anywhere: set {SETTING} to ["{_example(destination)}"] and start the service again'
            raise RefusedDestinationError(msg)
        address = _address(destination.host)
        if address is not None:
            self._check_address(address, destination)
        elif (destination.host, destination.port) not in self._names:
            msg = f"{destination.authority!r} is not allowed: add {_example(destination)!r} to {SETTING}"
            raise RefusedDestinationError(msg)
        elif destination.scheme == "http" and not self._networks:
            msg = f"http reaches allowed networks alone: use https, or add {destination.host!r}'s network to {SETTING}"
            raise RefusedDestinationError(msg)

    def check_addresses(self, texts: Iterable[str], destination: Destination) -> list[str]:
        """Return the addresses to which a destination's name leads, all of which must be allowed."""
        checked = []
        for text in texts:
            address = _address(text)
            if address is None:
                raise RefusedDestinationError(
                    f"{destination.host!r} leads to {text!r}, which is no address that can be checked"
                )
            self._check_address(address, destination)
            checked.append(str(address))
        return checked

    def _check_address(self, address: Address, destination: Destination) -> None:
        if any(address in network for network in self._networks):
            return
        cure = f"add {str(address)!r} or its network to {SETTING}"
        if _address(destination.host) is not None:
            raise RefusedDestinationError(f"{destination.host} lies in no network that is allowed: {cure}")
        leads = f"{destination.host!r} leads to {address}"
        if not _is_public(address):
            raise RefusedDestinationError(f"{leads}, which is no public address: {cure}")
        if destination.scheme == "http":
            raise RefusedDestinationError(f"{leads}, and http reaches allowed networks alone: use https, or {cure}")


def _address(text: str) -> Address | None:
    """Parse an address, an IPv4-mapped IPv6 address as IPv4; None: the text is a name, or has a zone."""
    try:
        address = ip_address(text)
    except ValueError:
        return None
    if isinstance(address, IPv6Address) and address.scope_id is not None:
        return None
    return getattr(address, "ipv4_mapped", None) or address


def _is_public(address: Address) -> bool:
    if isinstance(address, IPv6Address) and address not in _GLOBAL_UNICAST:
        return False
    return address.is_global and not address.is_multicast and not any(address in network for network in _NOT_PUBLIC)


def _example(destination: Destination) -> str:
    """Return the entry that would allow the destination."""
    if _address(destination.host) is not None or destination.port in STANDARD_PORTS:
        return destination.host
    return f"{destination.host}:{destination.port}"
