from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypeVar, cast

from attrs import define as _attrs_define

T = TypeVar("T", bound="WebhookTest")


@_attrs_define
class WebhookTest:
    """The outcome of a message that was sent for a test."""

    delivered: bool
    """ Whether the receiver answered with 200 to 299. """
    message_id: str
    """ As `webhook-id` has it. """
    reason: None | str
    """ Why it was not delivered. Null: it was. """
    status: int | None
    """ The answer's status. Null: there was none. """
    webhook_id: str
    """ Id of the webhook. """

    def to_dict(self) -> dict[str, Any]:
        delivered = self.delivered

        message_id = self.message_id

        reason: None | str
        reason = self.reason

        status: int | None
        status = self.status

        webhook_id = self.webhook_id

        field_dict: dict[str, Any] = {}

        field_dict.update(
            {
                "delivered": delivered,
                "message_id": message_id,
                "reason": reason,
                "status": status,
                "webhook_id": webhook_id,
            }
        )

        return field_dict

    @classmethod
    def from_dict(cls: type[T], src_dict: Mapping[str, Any]) -> T:
        d = dict(src_dict)
        delivered = d.pop("delivered")

        message_id = d.pop("message_id")

        def _parse_reason(data: object) -> None | str:
            if data is None:
                return data
            return cast(None | str, data)

        reason = _parse_reason(d.pop("reason"))

        def _parse_status(data: object) -> int | None:
            if data is None:
                return data
            return cast(int | None, data)

        status = _parse_status(d.pop("status"))

        webhook_id = d.pop("webhook_id")

        webhook_test = cls(
            delivered=delivered,
            message_id=message_id,
            reason=reason,
            status=status,
            webhook_id=webhook_id,
        )

        return webhook_test
