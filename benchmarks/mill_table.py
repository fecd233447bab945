"""The mill's study as a table: what was true, what was promised, what was named."""

import json
import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
from mill_names import NAMED_BY, causes, names_it
from mill_scans import EFFECTS
from scipy.special import bdtr, betaincinv

TOLERANCE_MM, GOOD_MM = 0.1, 0.05
PROMISED, TEST_LEVEL = 0.95, 0.01
# A plain fit that an effect puts off by more: it has to be named.
MATTERS_MM = 0.05
HEADER = (
    f"{'':14s} {'scans':>5s} {'effect':>6s} {'error':>6s} {'bound':>6s} {'holds':>7s} {'pass':>6s} {'watch':>6s} "
    f"{'fail':>6s} {'wrong':>11s} {'of good':>7s} {'named':>6s} {'scale':>6s} {'bound':>6s} {'holds':>7s} {'s':>5s}"
)


@dataclass(frozen=True)
class Outcome:
    """The part of one scan's line of the results file that the table needs."""

    number: int
    kind: str
    sizes: dict[str, float]
    effect_mm: float | None = None
    refused: str | None = None
    crashed: str | None = None
    error_mm: float = math.nan
    upper_95_mm: float = math.nan
    right_hypothesis: bool = True
    scale_error_percent: float = math.nan
    scale_uncertainty_percent: float = math.nan
    verdict: str = ""
    rays_verdict: str = ""
    adjustments: tuple[str, ...] = ()
    reasons: tuple[str, ...] = ()
    seconds: float = math.nan

    @classmethod
    def of(cls, line: dict[str, Any]) -> "Outcome":
        """Read a line of the results file."""
        return cls(**{field.name: line[field.name] for field in fields(cls) if field.name in line})

    @property
    def answered(self) -> bool:
        """Neither refused nor crashed."""
        return bool(self.verdict)

    @property
    def passed(self) -> bool:
        """Called good."""
        return self.verdict == "pass"

    @property
    def must_be_named(self) -> bool:
        """True if there is one effect, which matters and can be seen."""
        return self.answered and self.kind == "single" and bool(NAMED_BY[self.only]) and self.plain_mm > MATTERS_MM

    @property
    def only(self) -> str:
        """The one effect."""
        return next(iter(self.sizes))

    @property
    def plain_mm(self) -> float:
        """Change of a plain fit by the effect, mm; inf where there is no fit, 0 where there is not one effect."""
        if self.kind != "single":
            return 0.0
        return math.inf if self.effect_mm is None else self.effect_mm

    @property
    def wrong(self) -> bool:
        """The rays passed, and should not have."""
        return self.rays_verdict == "pass" and (self.error_mm > TOLERANCE_MM or not self.right_hypothesis)

    @property
    def named(self) -> frozenset[str]:
        """The causes in its sentences."""
        return causes((*self.adjustments, *self.reasons))


def read(path: Path) -> list[Outcome]:
    """Read the results so far, the first of each scan."""
    lines = [json.loads(line) for line in path.read_text().split("\n")[:-1]]
    return [Outcome.of(line) for line in {line["number"]: line for line in reversed(lines)}.values()]


def largest_share(count: int, number: int) -> float:
    """Bound the share of an event seen `count` times in `number`, with 95 % confidence (Clopper and Pearson)."""
    return 1.0 if count >= number else float(betaincinv(count + 1, number - count, 0.95))


def _holds(errors: Sequence[float], bounds: Sequence[float]) -> str:
    """Format the share below the bound; a star where 95 % are refuted at 1 %."""
    inside = sum(error <= bound for error, bound in zip(errors, bounds, strict=True))
    refuted = bdtr(inside, len(errors), PROMISED) < TEST_LEVEL
    return f"{inside / len(errors):6.1%}{'*' if refuted else ' '}"


def _share(values: Sequence[bool]) -> str:
    return f"{np.mean(values):6.0%}" if values else "     -"


def _naming(name: str, answered: list[Outcome]) -> str:
    """Format the share that names nothing (clean), or the share that names the one effect that matters."""
    if name == "clean":
        return f"{np.mean([not one.named for one in answered]):6.1%}"
    return _share([names_it(one.only, one.named) for one in answered if one.must_be_named])


def row(name: str, outcomes: list[Outcome]) -> str:
    """Format one line of the table."""
    answered = [one for one in outcomes if one.answered]
    none = Counter(one.refused or one.crashed for one in outcomes if not one.answered)
    refusals = "".join(f" {count} x {what}" for what, count in none.most_common(2))
    if not answered:
        return f"{name:14s} {len(outcomes):5d}{refusals}"
    errors, bounds = [one.error_mm for one in answered], [one.upper_95_mm for one in answered]
    scales = [abs(one.scale_error_percent) for one in answered]
    scale_bounds = [one.scale_uncertainty_percent for one in answered]
    passes, wrong = sum(one.rays_verdict == "pass" for one in answered), sum(one.wrong for one in answered)
    effects = [one.plain_mm for one in answered]
    good = [one.passed for one in answered if one.error_mm < GOOD_MM]
    verdicts = [_share([one.verdict == verdict for one in answered]) for verdict in ("pass", "watch", "fail")]
    return (
        f"{name:14s} {len(outcomes):5d} {np.median(effects):6.3f} {np.median(errors):6.3f} "
        f"{np.median(bounds):6.3f} {_holds(errors, bounds)} {' '.join(verdicts)} "
        f"{wrong:3d} < {largest_share(wrong, passes):5.2%} {_share(good):>7s} "
        f"{_naming(name, answered):>6s} {np.median(scales):6.3f} {np.median(scale_bounds):6.3f} "
        f"{_holds(scales, scale_bounds)} {np.median([one.seconds for one in answered]):5.2f}{refusals}"
    )


def table(outcomes: list[Outcome]) -> str:
    """Format the whole table."""
    groups = {"clean": [one for one in outcomes if one.kind == "clean"]}
    groups |= {name: [one for one in outcomes if one.kind == "single" and name in one.sizes] for name in EFFECTS}
    groups |= {"all singles": [one for one in outcomes if one.kind == "single"]}
    groups |= {"pairs": [one for one in outcomes if one.kind == "pair"], "all": outcomes}
    lines = [HEADER, *(row(name, group) for name, group in groups.items() if group)]
    clean = [one for one in groups["clean"] if one.answered]
    if clean:
        ratio = np.median([one.upper_95_mm for one in clean]) / np.sqrt(np.mean([one.error_mm**2 for one in clean]))
        lines.append(f"clean scans: median bound over the RMS of the true errors {ratio:.2f}")
    matter = [one for one in outcomes if one.must_be_named]
    if matter:
        named = np.mean([names_it(one.only, one.named) for one in matter])
        lines.append(f"single effects above {MATTERS_MM} mm: {len(matter)}, of which named {named:.1%}")
    return "\n".join(lines + _most_named(groups))


def summary(outcomes: list[Outcome]) -> dict[str, Any]:
    """Return the figures of the pages."""
    answered = [one for one in outcomes if one.answered]
    passes, wrong = sum(one.rays_verdict == "pass" for one in answered), sum(one.wrong for one in answered)
    return {
        "scans": len(outcomes),
        "answered": len(answered),
        "passed_percent": 100.0 * sum(one.passed for one in answered) / len(outcomes),
        "wrong": wrong,
        "wrong_below_percent": 100.0 * largest_share(wrong, passes),
        "median_error_mm": float(np.median([one.error_mm for one in answered])),
        "table": f"```text\n{table(outcomes)}\n```",
    }


def _most_named(groups: dict[str, list[Outcome]]) -> list[str]:
    """List the causes named in each group, the most frequent first."""
    lines = ["named:"]
    for name, group in groups.items():
        answered = [one for one in group if one.answered]
        often = Counter(cause for one in answered for cause in one.named).most_common(5)
        if often:
            lines.append(f"  {name:14s} " + ", ".join(f"{cause} {count / len(answered):.0%}" for cause, count in often))
    return lines
