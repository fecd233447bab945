"""The two questions next to every verdict of a calibration: are the rays right, are the millimetres right.

A number, its limit and a sentence answer each question. The sentences are texts to be translated; a page gives its own
`gettext` and its own way of writing millimetres and per cent.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import StrEnum
from types import MappingProxyType
from typing import Self

from sawmill_contracts.calibrations import CalibrationLimits, CalibrationResult
from sawmill_contracts.fixed_pairs import FixedPairsResult
from sawmill_contracts.plans import PlanResult
from sawmill_contracts.scanners import Tolerances
from sawmill_vocabulary import CalibrationStatus, Verdict
from sawmill_vocabulary.messages import N_
from sawmill_vocabulary.pair_messages import PairMessage
from sawmill_vocabulary.uncertainty import ContrastLoss

Words = Callable[[str], str]
Written = Callable[[float], str]


# Meaning of a verdict, in a sentence.
VERDICTS: Mapping[Verdict, str] = MappingProxyType(
    {
        "pass": "The geometry is known well enough to be used.",
        "watch": "There is a geometry, but look at it before it is used.",
        "fail": "This geometry must not be used.",
    }
)


class Answer(StrEnum):
    """An answer to a question about a calibration; `accepted`: somebody accepted the calibration that shows it."""

    YES = "yes"
    LOOK = "look"
    NO = "no"
    UNKNOWN = "unknown"
    ACCEPTED = "accepted"


def in_mm(value_mm: float) -> str:
    """Write millimetres in English, to a thousandth, for ray errors."""
    return f"{value_mm:.3f} mm"


def in_length(value_mm: float) -> str:
    """Write millimetres in English, to two significant digits below 10 mm and to one mm above, for lengths of a log."""
    return f"{value_mm:.0f} mm" if value_mm >= 9.95 else f"{value_mm:.2g} mm"


def in_percent(value: float) -> str:
    """Write per cent in English, to two significant digits."""
    return f"{value:.2g} %"


@dataclass(frozen=True)
class RaysRight:
    """The first question, whether the rays are right among themselves: this makes an image sharp."""

    upper_95_mm: float | None  # upper 95 % limit of the RMS ray error; None without error bars
    limit_mm: float | None  # the largest allowed value; None where nobody recorded it
    verdict: Verdict  # the verdict on the rays alone; in an answer of an earlier version the whole verdict
    lost: ContrastLoss | None = None  # what such rays cost; None where it is not known

    question = N_("Are the rays right?")

    @property
    def within(self) -> bool | None:
        """True if the number keeps its limit; None where either is not known."""
        return _within(self.upper_95_mm, self.limit_mm)

    @property
    def answer(self) -> Answer:
        """Answer by the verdict, which knows more than the number, unless the number is beyond its limit."""
        if self.verdict == "fail":
            return Answer.NO
        if self.upper_95_mm is None:
            return Answer.UNKNOWN
        return Answer.LOOK if self.verdict == "watch" or self.within is False else Answer.YES

    @property
    def message(self) -> str:
        """Sentence with its placeholders: %(bound)s and %(limit)s, both in mm."""
        if self.upper_95_mm is None and self.verdict == "fail":
            return N_("It has no error bars, and what is known speaks against it.")
        if self.upper_95_mm is None:
            return N_("Not known: this calibration has no error bars.")
        if self.limit_mm is None:
            return N_("In 95 of 100 cases the rays are off by less than %(bound)s. The tolerance is not recorded.")
        if not self.within:
            return N_("In 95 of 100 cases the rays are off by less than %(bound)s, but only %(limit)s is allowed.")
        if self.verdict == "pass":
            return N_("In 95 of 100 cases the rays are off by less than %(bound)s; %(limit)s is allowed.")
        return N_("By its number, %(bound)s where %(limit)s is allowed; but something else speaks against it.")

    def sentence(self, words: Words = str, mm: Written = in_mm) -> str:
        """Return the answer, and what such rays cost if that matters, in the language of `words`."""
        places = {"bound": self.upper_95_mm, "limit": self.limit_mm}
        answer = words(self.message) % {name: mm(value) for name, value in places.items() if value is not None}
        if self.lost is None or not self.lost.matters:
            return answer
        cost = words(N_("Knots of 10 mm may lose up to %(percent)d %% of their contrast."))
        return f"{answer} {cost % {'percent': round(self.lost.knot_10_mm_percent)}}"


@dataclass(frozen=True)
class MillimetresRight:
    """The second question, whether the image's millimetres are right: the phantom's size is the ruler of the scale."""

    percent_95: float | None  # 95 % uncertainty of sizes in the image; None where it is not known
    limit_percent: float | None  # the largest allowed value; None where nobody recorded it
    diameter_mm: float  # diameter of the largest log: the disc in which ray errors are counted
    contradicted: bool = False  # whether the phantom's size and the scanner's constants contradict each other

    question = N_("Are the millimetres right?")

    @property
    def within(self) -> bool | None:
        """True if the number keeps its limit; None where either is not known."""
        return _within(self.percent_95, self.limit_percent)

    @property
    def on_diameter_mm(self) -> float | None:
        """The number on the diameter of the largest log, mm."""
        return _share(self.percent_95, self.diameter_mm)

    @property
    def limit_on_diameter_mm(self) -> float | None:
        """The limit on the diameter of the largest log, mm."""
        return _share(self.limit_percent, self.diameter_mm)

    @property
    def answer(self) -> Answer:
        """Answer in a word; an uncertain scale blurs nothing, so the answer is at worst `look`."""
        if self.contradicted:
            return Answer.NO
        if self.within is None:
            return Answer.UNKNOWN
        return Answer.YES if self.within else Answer.LOOK

    @property
    def message(self) -> str:
        """Sentence with its placeholders: %(percent)s, %(limit)s (per cent), %(error)s and %(diameter)s (lengths)."""
        if self.contradicted:
            return N_("The phantom's size and the scanner's constants contradict each other: measure both.")
        if self.percent_95 is None:
            return N_("Not known: this calibration gives no such number.")
        if self.limit_percent is None:
            return N_("Sizes are right to %(percent)s: %(error)s on a log of %(diameter)s. No limit is recorded.")
        if not self.within:
            return N_("Sizes are right to %(percent)s: %(error)s on a log of %(diameter)s. Only %(limit)s is allowed.")
        return N_("Sizes are right to %(percent)s: %(error)s on a log of %(diameter)s; %(limit)s is allowed.")

    def sentence(self, words: Words = str, length: Written = in_length, percent: Written = in_percent) -> str:
        """Return the answer in one sentence, in the language of `words`."""
        lengths = {"error": self.on_diameter_mm, "diameter": self.diameter_mm}
        shares = {"percent": self.percent_95, "limit": self.limit_percent}
        places = {name: length(value) for name, value in lengths.items() if value is not None}
        places |= {name: percent(value) for name, value in shares.items() if value is not None}
        return words(self.message) % places


@dataclass(frozen=True)
class TwoQuestions:
    """The two questions about one calibration."""

    rays: RaysRight
    millimetres: MillimetresRight

    @classmethod
    def of(cls, result: CalibrationResult, tolerances: Tolerances | None) -> Self:
        """Ask about an answer and the limits with which it was compared.

        Parameters
        ----------
        tolerances : Tolerances or None
            The scanner's tolerances, for an answer of an earlier version, which does not have its limits; None where no
            scanner is known.
        """
        predicted, status = result.predicted_ray_error_mm, result.status
        limits = result.limits or (None if tolerances is None else CalibrationLimits.of(tolerances))
        failed = status is CalibrationStatus.NOT_CONVERGED
        return cls(
            RaysRight(
                upper_95_mm=None if predicted is None else predicted.upper_95,
                limit_mm=None if limits is None else limits.tolerance_mm,
                verdict=result.verdict_on_rays,
                lost=None if predicted is None else predicted.contrast_loss,
            ),
            MillimetresRight(
                percent_95=None if failed else result.scale_uncertainty_percent,
                limit_percent=None if limits is None else limits.scale_tolerance_percent,
                diameter_mm=2.0 * result.radius_mm,
                contradicted=status is CalibrationStatus.INCONSISTENT_SCALE,
            ),
        )

    @classmethod
    def of_pairs(cls, result: FixedPairsResult) -> Self:
        """Ask about the calibration of a scanner of fixed pairs; the scale alone speaks against no ray."""
        of_rays = {reason.code for reason in result.coded_reasons} - {PairMessage.SCALE, PairMessage.BACKWARDS}
        limits = result.options
        return cls(
            RaysRight(result.upper_95_mm, limits.tolerance_mm, result.verdict if of_rays else "pass"),
            MillimetresRight(
                percent_95=result.scale_uncertainty_percent,
                limit_percent=limits.scale_tolerance_percent,
                diameter_mm=2.0 * result.log_radius_mm,
            ),
        )

    @classmethod
    def of_plan(cls, planned: PlanResult, tolerances: Tolerances) -> Self:
        """Ask about a plan and a scanner's tolerances; only noise and the phantom's size can speak against a plan."""
        predicted, limit_mm = planned.predicted_ray_error_mm, tolerances.predicted_ray_error_mm
        verdict: Verdict = "pass" if predicted.upper_95 <= limit_mm else "fail"
        return cls(
            RaysRight(predicted.upper_95, limit_mm, verdict, predicted.contrast_loss),
            MillimetresRight(
                percent_95=planned.scale_uncertainty_percent,
                limit_percent=tolerances.scale_percent,
                diameter_mm=2.0 * predicted.radius_mm,
            ),
        )


def _within(value: float | None, limit: float | None) -> bool | None:
    return None if value is None or limit is None else value <= limit


def _share(percent: float | None, of: float) -> float | None:
    return None if percent is None else percent / 100.0 * of
