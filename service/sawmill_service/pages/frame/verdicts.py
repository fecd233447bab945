"""The questions of a verdict on pages: a word, a number against its limit, a sentence."""

import gettext
from collections.abc import Callable
from dataclasses import dataclass, replace

from sawmill_contracts.calibrations import CalibrationResult
from sawmill_contracts.scanners import Tolerances
from sawmill_mill.anything_moved import AnythingMoved
from sawmill_mill.two_questions import Answer, TwoQuestions
from sawmill_service.pages.frame.languages import Formats, marked

_WORDS = {
    Answer.YES: ("good", marked("Yes")),
    Answer.LOOK: ("watch", marked("Look at it")),
    Answer.NO: ("bad", marked("No")),
    Answer.UNKNOWN: ("idle", marked("Not known")),
    Answer.ACCEPTED: ("idle", marked("Accepted")),
}

# The third question's words: its good answer is No.
_MOVED_WORDS = {Answer.YES: marked("No"), Answer.NO: marked("Yes"), Answer.LOOK: marked("Yes")}


@dataclass(frozen=True)
class ShownQuestion:
    """Question of a verdict with its answer, in a language."""

    # question, word, sentence: question, and the answer in a word and in a sentence.
    question: str
    word: str
    tone: str  # colour: good, watch, bad or idle
    sentence: str
    # value, limit: number and its limit, with their units.
    value: str | None
    limit: str | None
    share: float | None  # number divided by its limit
    during: str = ""  # what moved during the scan; empty: nothing


def shown_questions(
    text: gettext.NullTranslations, formats: Formats
) -> Callable[[CalibrationResult, Tolerances | None, bool], list[ShownQuestion]]:
    """Return the function that templates call with a calibration and its scanner's tolerances (`verdict_questions`)."""

    def shown(calibration: CalibrationResult, tolerances: Tolerances | None, active: bool) -> list[ShownQuestion]:  # noqa: FBT001 - templates call it
        pair = shown_pair(TwoQuestions.of(calibration, tolerances), text, formats)
        return [*pair, _shown_movement(AnythingMoved.of(calibration, accepted=active), text, formats)]

    return shown


def _shown_movement(moved: AnythingMoved, text: gettext.NullTranslations, formats: Formats) -> ShownQuestion:
    """Return the third question, with a movement since the calibration in use and one during the scan apart."""
    sentence = moved.reason.in_words(formats.reader).headline
    shown = _shown(text, moved.question, moved.answer, sentence, moved.moved_mm, moved.limit_mm, formats.mm)
    during = "" if moved.slip is None else moved.slip.in_words(formats.reader).headline
    word = text.gettext(_MOVED_WORDS[moved.answer]) if moved.answer in _MOVED_WORDS else shown.word
    return replace(shown, word=word, during=during)


def shown_pair(two: TwoQuestions, text: gettext.NullTranslations, formats: Formats) -> list[ShownQuestion]:
    """Return both questions with their answers, for a calibration or a plan."""
    rays, millimetres = two.rays, two.millimetres
    rays_sentence = rays.sentence(text.gettext, formats.mm)
    return [
        _shown(text, rays.question, rays.answer, rays_sentence, rays.upper_95_mm, rays.limit_mm, formats.mm),
        _shown(
            text,
            millimetres.question,
            millimetres.answer,
            millimetres.sentence(text.gettext, formats.log_mm, formats.share),
            millimetres.percent_95,
            millimetres.limit_percent,
            formats.share,
        ),
    ]


def _shown(
    text: gettext.NullTranslations,
    question: str,
    answer: Answer,
    sentence: str,
    value: float | None,
    limit: float | None,
    written: Callable[[float], str],
) -> ShownQuestion:
    tone, word = _WORDS[answer]
    return ShownQuestion(
        question=text.gettext(question),
        word=text.gettext(word),
        tone=tone,
        sentence=sentence,
        value=None if value is None else written(value),
        limit=None if limit is None else written(limit),
        share=None if value is None or not limit else value / limit,
    )
