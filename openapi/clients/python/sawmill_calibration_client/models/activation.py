from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypeVar, cast

from attrs import define as _attrs_define

from ..types import UNSET, Unset

T = TypeVar("T", bound="Activation")


@_attrs_define
class Activation:
    """An entry of kind `activation`, as version 0.1.0 had it: from then on this calibration was the active one."""

    activated_at: str
    """ When it became the active one, RFC 3339, UTC. """
    calibration_id: str
    """ Id of the calibration. """
    reason: str
    """ Who or what activated it. """
    activated_by: None | str | Unset = UNSET
    """ The name of the key; null: an entry from before there was an audit. """

    def to_dict(self) -> dict[str, Any]:
        activated_at = self.activated_at

        calibration_id = self.calibration_id

        reason = self.reason

        activated_by: None | str | Unset
        if isinstance(self.activated_by, Unset):
            activated_by = UNSET
        else:
            activated_by = self.activated_by

        field_dict: dict[str, Any] = {}

        field_dict.update(
            {
                "activated_at": activated_at,
                "calibration_id": calibration_id,
                "reason": reason,
            }
        )
        if activated_by is not UNSET:
            field_dict["activated_by"] = activated_by

        return field_dict

    @classmethod
    def from_dict(cls: type[T], src_dict: Mapping[str, Any]) -> T:
        d = dict(src_dict)
        activated_at = d.pop("activated_at")

        calibration_id = d.pop("calibration_id")

        reason = d.pop("reason")

        def _parse_activated_by(data: object) -> None | str | Unset:
            if data is None:
                return data
            if isinstance(data, Unset):
                return data
            return cast(None | str | Unset, data)

        activated_by = _parse_activated_by(d.pop("activated_by", UNSET))

        activation = cls(
            activated_at=activated_at,
            calibration_id=calibration_id,
            reason=reason,
            activated_by=activated_by,
        )

        return activation
