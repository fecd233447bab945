"""Reasons for programs: the code and the values of a sentence for people, and all messages by their codes."""

from collections.abc import Iterable, Mapping
from types import MappingProxyType
from typing import Self

from pydantic import Field

from sawmill_platform.contracts.base import Contract
from sawmill_vocabulary.calibration_messages import CalibrationMessage, ResidualMessage
from sawmill_vocabulary.image_messages import ImageMessage
from sawmill_vocabulary.messages import Message, Reason
from sawmill_vocabulary.movement_messages import LogMessage, MovementMessage
from sawmill_vocabulary.pair_messages import PairMessage
from sawmill_vocabulary.reading_messages import PreparingMessage, ReadingMessage
from sawmill_vocabulary.scan_messages import AdjustmentMessage, EffectMessage


class CodedReason(Contract):
    """A reason: its code, its values, and the English sentence that is made from them."""

    code: str | None = Field(
        description="Code of the reason, stable, for programs. Null: an earlier version stored the sentence alone.",
        examples=["moved"],
    )
    values: dict[str, float | str] = Field(
        {},
        description="Values in the sentence by name; the unit stands at the end of a name.",
        examples=[{"moved_mm": 0.66, "allowed_mm": 0.5}],
    )
    sentence: str = Field(
        description="English sentence that is made from the code and the values.",
        examples=["Something has moved: 0.66 mm, and 0.50 mm is allowed."],
    )
    parts: list["CodedReason"] = Field(
        [], description="Reasons that are a part of this one, such as the cause of a movement."
    )

    @classmethod
    def of(cls, sentence: str) -> Self:
        """Build the record of a reason, or of a sentence without a code."""
        if not isinstance(sentence, Reason):
            return cls(code=None, sentence=sentence)
        parts = [cls.of(part) for part in sentence.parts]
        return cls(code=sentence.message.value, values=dict(sentence.values), sentence=str(sentence), parts=parts)

    @classmethod
    def all_of(cls, coded: Iterable[Self], sentences: Iterable[str]) -> list[Self]:
        """Return the coded reasons; of an earlier version, which stored none, the sentences without a code."""
        return list(coded) or [cls.of(each) for each in sentences]

    @property
    def text(self) -> str:
        """The reason, or the sentence alone where this version does not know the code."""
        return self.reason or self.sentence

    @property
    def reason(self) -> Reason | None:
        """The reason, which has words in every language; None without a code that this version knows."""
        message, parts = MESSAGES.get(self.code or ""), [part.reason for part in self.parts]
        known = [part for part in parts if part is not None]
        return None if message is None or len(known) < len(parts) else Reason(message, self.values, known)


_ENUMS = (
    CalibrationMessage,
    ResidualMessage,
    PairMessage,
    MovementMessage,
    LogMessage,
    EffectMessage,
    AdjustmentMessage,
    ReadingMessage,
    PreparingMessage,
    ImageMessage,
)
MESSAGES: Mapping[str, Message] = MappingProxyType({one.value: one for enum in _ENUMS for one in enum})
