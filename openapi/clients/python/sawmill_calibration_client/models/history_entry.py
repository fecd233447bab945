from __future__ import annotations

import datetime
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, TypeVar, cast

from attrs import define as _attrs_define

from ..models.alarm_kind import AlarmKind
from ..models.event_kind import EventKind
from ..models.history_kind import HistoryKind

if TYPE_CHECKING:
    from ..models.measurement import Measurement


T = TypeVar("T", bound="HistoryEntry")


@_attrs_define
class HistoryEntry:
    """One thing that happened to a scanner."""

    alarm: AlarmKind | None
    """ Which alarm. Null: the entry is of none. """
    at: datetime.datetime
    """ When it happened; of a calibration or a drift check, when its job ended. """
    key_id: None | str
    """ Id of that key. Null: it was none. """
    kind: HistoryKind
    """ What an entry is about. """
    link: None | str
    """ Path of what it happened to. Null: that was deleted since. """
    measured: Measurement | None
    """ What a calibration or a drift check that succeeded measured. Null: any other entry. """
    number: int
    """ Number of the entry. """
    subject: str
    """ What `subject_id` names: `calibration`, `drift`, `scanner`, `schedule` or `scan`. """
    subject_id: str
    """ What it happened to. """
    what: EventKind
    """ What happened. """
    who: None | str
    """ Of a calibration or a drift check who asked for it, of a cancelled one who cancelled it; else who did it.
    The name of a key, `schedule` and its id, or `the service`. Null: an earlier version did not keep it. """
    why: None | str
    """ In English: the reason given with an activation, what a calibration or a drift check says, why one failed,
    what is missing, what was changed and from what. Null: nothing is known. """

    def to_dict(self) -> dict[str, Any]:
        from ..models.measurement import Measurement  # noqa: PLC0415

        alarm: None | str
        if isinstance(self.alarm, AlarmKind):
            alarm = self.alarm.value
        else:
            alarm = self.alarm

        at = self.at.isoformat()

        key_id: None | str
        key_id = self.key_id

        kind = self.kind.value

        link: None | str
        link = self.link

        measured: dict[str, Any] | None
        if isinstance(self.measured, Measurement):
            measured = self.measured.to_dict()
        else:
            measured = self.measured

        number = self.number

        subject = self.subject

        subject_id = self.subject_id

        what = self.what.value

        who: None | str
        who = self.who

        why: None | str
        why = self.why

        field_dict: dict[str, Any] = {}

        field_dict.update(
            {
                "alarm": alarm,
                "at": at,
                "key_id": key_id,
                "kind": kind,
                "link": link,
                "measured": measured,
                "number": number,
                "subject": subject,
                "subject_id": subject_id,
                "what": what,
                "who": who,
                "why": why,
            }
        )

        return field_dict

    @classmethod
    def from_dict(cls: type[T], src_dict: Mapping[str, Any]) -> T:
        from ..models.measurement import Measurement  # noqa: PLC0415

        d = dict(src_dict)

        def _parse_alarm(data: object) -> AlarmKind | None:
            if data is None:
                return data
            try:
                if not isinstance(data, str):
                    raise TypeError()
                alarm_type_0 = AlarmKind(data)

                return alarm_type_0
            except (TypeError, ValueError, AttributeError, KeyError):
                pass
            return cast(AlarmKind | None, data)

        alarm = _parse_alarm(d.pop("alarm"))

        at = datetime.datetime.fromisoformat(d.pop("at"))

        def _parse_key_id(data: object) -> None | str:
            if data is None:
                return data
            return cast(None | str, data)

        key_id = _parse_key_id(d.pop("key_id"))

        kind = HistoryKind(d.pop("kind"))

        def _parse_link(data: object) -> None | str:
            if data is None:
                return data
            return cast(None | str, data)

        link = _parse_link(d.pop("link"))

        def _parse_measured(data: object) -> Measurement | None:
            if data is None:
                return data
            try:
                if not isinstance(data, dict):
                    raise TypeError()
                measured_type_0 = Measurement.from_dict(data)

                return measured_type_0
            except (TypeError, ValueError, AttributeError, KeyError):
                pass
            return cast(Measurement | None, data)

        measured = _parse_measured(d.pop("measured"))

        number = d.pop("number")

        subject = d.pop("subject")

        subject_id = d.pop("subject_id")

        what = EventKind(d.pop("what"))

        def _parse_who(data: object) -> None | str:
            if data is None:
                return data
            return cast(None | str, data)

        who = _parse_who(d.pop("who"))

        def _parse_why(data: object) -> None | str:
            if data is None:
                return data
            return cast(None | str, data)

        why = _parse_why(d.pop("why"))

        history_entry = cls(
            alarm=alarm,
            at=at,
            key_id=key_id,
            kind=kind,
            link=link,
            measured=measured,
            number=number,
            subject=subject,
            subject_id=subject_id,
            what=what,
            who=who,
            why=why,
        )

        return history_entry
