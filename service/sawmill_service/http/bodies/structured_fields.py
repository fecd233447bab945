"""Structured fields (RFC 9651), as far as this service's headers need them. A malformed field is read as None."""

import re
from base64 import b64decode

_KEY = r"[a-z*][a-z0-9_.*-]*"
_BARE = (
    r"(?:-?\d{1,12}\.\d{1,3}|-?\d{1,15}|@-?\d{1,15}|\?[01]"
    r"|%?\"(?:[ !#-\[\]-~]|\\[\"\\])*\"|:[A-Za-z0-9+/=]*:|[A-Za-z*][!#$%&'*+.^_`|~:/0-9A-Za-z-]*)"
)
# No field that this service reads has parameters; unknown ones are ignored (section 1.1).
_PARAMETERS = rf"(?:;[ ]*{_KEY}(?:={_BARE})?)*"
_ITEM = re.compile(rf"[ ]*({_BARE}){_PARAMETERS}[ ]*", re.ASCII)
_MEMBER = re.compile(rf"[ \t]*({_KEY})(?:=({_BARE}))?{_PARAMETERS}[ \t]*(,|$)", re.ASCII)


def integer_in(text: str) -> int | None:
    """Read an item that is an integer (section 3.3.1)."""
    bare = _bare_in(text)
    return int(bare) if bare is not None and re.fullmatch(r"-?\d+", bare, re.ASCII) else None


def boolean_in(text: str) -> bool | None:
    """Read an item that is a boolean (section 3.3.6): `?1` or `?0`."""
    return {"?1": True, "?0": False}.get(_bare_in(text) or "")


def bytes_in(text: str) -> bytes | None:
    """Read an item that is a sequence of bytes (section 3.3.5), as in `:aGVsbG8=:`."""
    bare = _bare_in(text) or ""
    try:
        return b64decode(bare[1:-1], validate=True) if bare.startswith(":") else None
    except ValueError:
        return None


def dictionary_in(text: str) -> dict[str, str] | None:
    """Read a dictionary of items (section 3.2), each as it is written; the last item of a name counts."""
    members, at = dict[str, str](), 0
    if not text.strip(" \t"):
        return members
    while (member := _MEMBER.match(text, at)) is not None:
        members[member[1]] = member[2] or "?1"
        at = member.end()
        if not member[3]:
            return members
    return None


def _bare_in(text: str) -> str | None:
    item = _ITEM.fullmatch(text)
    return None if item is None else item[1]
