"""All messages of the science by their codes, for readers of stored results."""

from collections.abc import Mapping
from types import MappingProxyType

from sawmill_vocabulary.calibration_messages import CalibrationMessage, ResidualMessage
from sawmill_vocabulary.image_messages import ImageMessage
from sawmill_vocabulary.messages import Message
from sawmill_vocabulary.movement_messages import LogMessage, MovementMessage
from sawmill_vocabulary.reading_messages import PreparingMessage, ReadingMessage
from sawmill_vocabulary.scan_messages import AdjustmentMessage, EffectMessage

_ENUMS = (
    CalibrationMessage,
    ResidualMessage,
    MovementMessage,
    LogMessage,
    EffectMessage,
    AdjustmentMessage,
    ReadingMessage,
    PreparingMessage,
    ImageMessage,
)
MESSAGES: Mapping[str, Message] = MappingProxyType({one.value: one for enum in _ENUMS for one in enum})
