from __future__ import annotations

import datetime
from collections.abc import Mapping
from typing import Any, TypeVar, cast

from attrs import define as _attrs_define

from ..models.scope import Scope
from ..types import UNSET, Unset

T = TypeVar("T", bound="KeyAsk")


@_attrs_define
class KeyAsk:
    """A key that is to be made."""

    name: str
    """ Whose it is: a person or a program. """
    scope: Scope
    """ What a key may do; each scope may do what those before it may. """
    display: bool | Unset = False
    """ For a display on the wall: a page that it has opened stays open as long as the key is good. Of scope `read`
    alone. """
    expires_at: datetime.datetime | None | Unset = UNSET
    """ From then on it opens nothing; null: never. """

    def to_dict(self) -> dict[str, Any]:
        name = self.name

        scope = self.scope.value

        display = self.display

        expires_at: None | str | Unset
        if isinstance(self.expires_at, Unset):
            expires_at = UNSET
        elif isinstance(self.expires_at, datetime.datetime):
            expires_at = self.expires_at.isoformat()
        else:
            expires_at = self.expires_at

        field_dict: dict[str, Any] = {}

        field_dict.update(
            {
                "name": name,
                "scope": scope,
            }
        )
        if display is not UNSET:
            field_dict["display"] = display
        if expires_at is not UNSET:
            field_dict["expires_at"] = expires_at

        return field_dict

    @classmethod
    def from_dict(cls: type[T], src_dict: Mapping[str, Any]) -> T:
        d = dict(src_dict)
        name = d.pop("name")

        scope = Scope(d.pop("scope"))

        display = d.pop("display", UNSET)

        def _parse_expires_at(data: object) -> datetime.datetime | None | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            try:
                if not isinstance(data, str):
                    raise TypeError()
                expires_at_type_0 = datetime.datetime.fromisoformat(data)

                return expires_at_type_0
            except (TypeError, ValueError, AttributeError, KeyError):
                pass
            return cast(datetime.datetime | None | Unset, data)

        expires_at = _parse_expires_at(d.pop("expires_at", UNSET))

        key_ask = cls(
            name=name,
            scope=scope,
            display=display,
            expires_at=expires_at,
        )

        return key_ask
