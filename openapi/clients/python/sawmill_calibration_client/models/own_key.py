from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypeVar, cast

from attrs import define as _attrs_define

from ..models.scope import Scope

T = TypeVar("T", bound="OwnKey")


@_attrs_define
class OwnKey:
    """With what a request came."""

    key_id: None | str
    """ Its id. Null: no key was needed, or it is the service's own token. """
    name: str
    """ The key's name. """
    scope: Scope
    """ What a key may do; each scope may do what those before it may. """

    def to_dict(self) -> dict[str, Any]:
        key_id: None | str
        key_id = self.key_id

        name = self.name

        scope = self.scope.value

        field_dict: dict[str, Any] = {}

        field_dict.update(
            {
                "key_id": key_id,
                "name": name,
                "scope": scope,
            }
        )

        return field_dict

    @classmethod
    def from_dict(cls: type[T], src_dict: Mapping[str, Any]) -> T:
        d = dict(src_dict)

        def _parse_key_id(data: object) -> None | str:
            if data is None:
                return data
            return cast(None | str, data)

        key_id = _parse_key_id(d.pop("key_id"))

        name = d.pop("name")

        scope = Scope(d.pop("scope"))

        own_key = cls(
            key_id=key_id,
            name=name,
            scope=scope,
        )

        return own_key
