from __future__ import annotations

import datetime
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, TypeVar, cast

from attrs import define as _attrs_define

from ..models.audit_action import AuditAction

if TYPE_CHECKING:
    from ..models.audit_entry_detail_type_0 import AuditEntryDetailType0


T = TypeVar("T", bound="AuditEntry")


@_attrs_define
class AuditEntry:
    """One thing that somebody did."""

    action: AuditAction
    """ What somebody did. """
    address: None | str
    """ From which the request came; null: it was no request. """
    at: datetime.datetime
    """ RFC 3339, UTC. """
    detail: AuditEntryDetailType0 | None
    """ What the subject was, and why, where something is known. """
    key_id: None | str
    """ Id of the key that the request brought. Null: it brought none. """
    number: int
    """ Number of the entry; it grows from entry to entry. """
    request_id: None | str
    """ The `X-Request-Id` of the request, as in its answer and in the log. Null: it was no request. """
    subject_id: str
    """ Id of what it was done to. """
    who: str
    """ The name of the key; `schedule` and its id, or `the service` where no person did it. """

    def to_dict(self) -> dict[str, Any]:
        from ..models.audit_entry_detail_type_0 import AuditEntryDetailType0  # noqa: PLC0415

        action = self.action.value

        address: None | str
        address = self.address

        at = self.at.isoformat()

        detail: dict[str, Any] | None
        if isinstance(self.detail, AuditEntryDetailType0):
            detail = self.detail.to_dict()
        else:
            detail = self.detail

        key_id: None | str
        key_id = self.key_id

        number = self.number

        request_id: None | str
        request_id = self.request_id

        subject_id = self.subject_id

        who = self.who

        field_dict: dict[str, Any] = {}

        field_dict.update(
            {
                "action": action,
                "address": address,
                "at": at,
                "detail": detail,
                "key_id": key_id,
                "number": number,
                "request_id": request_id,
                "subject_id": subject_id,
                "who": who,
            }
        )

        return field_dict

    @classmethod
    def from_dict(cls: type[T], src_dict: Mapping[str, Any]) -> T:
        from ..models.audit_entry_detail_type_0 import AuditEntryDetailType0  # noqa: PLC0415

        d = dict(src_dict)
        action = AuditAction(d.pop("action"))

        def _parse_address(data: object) -> None | str:
            if data is None:
                return data
            return cast(None | str, data)

        address = _parse_address(d.pop("address"))

        at = datetime.datetime.fromisoformat(d.pop("at"))

        def _parse_detail(data: object) -> AuditEntryDetailType0 | None:
            if data is None:
                return data
            try:
                if not isinstance(data, dict):
                    raise TypeError()
                detail_type_0 = AuditEntryDetailType0.from_dict(data)

                return detail_type_0
            except (TypeError, ValueError, AttributeError, KeyError):
                pass
            return cast(AuditEntryDetailType0 | None, data)

        detail = _parse_detail(d.pop("detail"))

        def _parse_key_id(data: object) -> None | str:
            if data is None:
                return data
            return cast(None | str, data)

        key_id = _parse_key_id(d.pop("key_id"))

        number = d.pop("number")

        def _parse_request_id(data: object) -> None | str:
            if data is None:
                return data
            return cast(None | str, data)

        request_id = _parse_request_id(d.pop("request_id"))

        subject_id = d.pop("subject_id")

        who = d.pop("who")

        audit_entry = cls(
            action=action,
            address=address,
            at=at,
            detail=detail,
            key_id=key_id,
            number=number,
            request_id=request_id,
            subject_id=subject_id,
            who=who,
        )

        return audit_entry
