"""The operator's page: is each scanner in tolerance, what moved and by how much, accept or roll back. Plain HTML."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape

from sawmill_worker.contracts.calibrations import CalibrationSucceeded, Comparison
from sawmill_worker.contracts.drifts import Drift, DriftResult
from sawmill_worker.contracts.jobs import Failure
from sawmill_worker.contracts.scanners import Activation, Scanner


@dataclass(frozen=True)
class ScannerCondition:
    """What the page shows of one scanner.

    `newest` is the newest calibration that succeeded, `failure` why a newer one did not; `drift` is the newest look at
    drift that succeeded or failed; `history` has the newest activation first.
    """

    scanner: Scanner
    newest: CalibrationSucceeded | None
    failure: Failure | None
    drift: Drift | None
    history: Sequence[Activation]

    @property
    def newest_is_active(self) -> bool:
        """Whether the newest calibration is what the scanner's reconstructions use."""
        return self.newest is not None and self.newest.id == self.scanner.active_calibration_id

    @property
    def drifted(self) -> DriftResult | None:
        """What a log has shown of the active calibration since the newest one, if it is out of tolerance."""
        look = self.drift
        if look is None or look.result is None or look.result.within_tolerance is not False:
            return None
        against_active = look.calibration_id == self.scanner.active_calibration_id
        since = self.newest is None or look.created_at >= self.newest.created_at
        return look.result if against_active and since else None


@dataclass(frozen=True)
class Standing:
    """Whether the scanner is in tolerance, in a word, a colour's name and a sentence."""

    word: str
    tone: str
    sentence: str


def standing(condition: ScannerCondition) -> Standing:
    """Judge by the newest calibration (its verdict, then what moved since the active one) and a later log."""
    newest = condition.newest
    if newest is None:
        return Standing("Not calibrated", "idle", "No calibration of this scanner has succeeded yet.")
    reasons = " ".join(newest.reasons)
    if newest.verdict == "fail":
        return Standing("Calibration failed its check", "bad", reasons)
    if moved := _moved_out_of_tolerance(condition):
        return Standing("Out of tolerance", "bad", moved)
    if newest.verdict == "watch":
        return Standing("Watch", "watch", reasons)
    if condition.scanner.active_calibration_id is None:
        return Standing("No active calibration", "watch", "The newest calibration passed: accept it to use it.")
    unmoved = newest.comparison.reason if newest.comparison and not condition.newest_is_active else ""
    return Standing("In tolerance", "good", unmoved or "The newest calibration passed and is the active one.")


def _moved_out_of_tolerance(condition: ScannerCondition) -> str:
    """What moved since the active calibration, as the newest one or a log since shows it; empty where nothing did."""
    comparison = condition.newest.comparison if condition.newest else None
    if comparison is not None and not comparison.within_tolerance and not condition.newest_is_active:
        return comparison.reason
    return f"A log shows: {condition.drifted.reason}." if condition.drifted else ""


def operator_page(conditions: Sequence[ScannerCondition]) -> str:
    """The whole page."""
    cards = "".join(_card(condition) for condition in conditions)
    return f"""<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>Sawmill calibration</title>
<link rel="stylesheet" href="/static/operator.css">
<link rel="icon" href="/static/mark.svg">
</head>
<body>
<header>
<h1><img src="/static/mark.svg" alt=""> Sawmill calibration</h1>
<nav><a href="/docs">API console</a></nav>
</header>
<main>{cards or '<p class="empty">There is no scanner yet: the API console creates one.</p>'}</main>
</body>
</html>
"""


def _card(condition: ScannerCondition) -> str:
    scanner, newest, state = condition.scanner, condition.newest, standing(condition)
    return f"""
<section class="card {state.tone}">
<div class="title"><h2>{escape(scanner.name)}</h2><span class="badge">{escape(state.word)}</span></div>
<p class="id">{escape(scanner.id)}</p>
<p>{escape(state.sentence)}</p>
{_failed(condition.failure) if condition.failure else ""}
{_newest(newest, active=condition.newest_is_active) if newest else ""}
{_drift(condition.drift) if condition.drift else ""}
{_history(condition)}
</section>"""


def _failed(failure: Failure) -> str:
    return f'<p class="failed">The last calibration gave no answer: {escape(failure.detail)}</p>'


def _newest(newest: CalibrationSucceeded, *, active: bool) -> str:
    ray_error = newest.predicted_ray_error_mm
    known = "not known" if ray_error is None else f"{ray_error.rms:.3f} mm RMS, 95 % below {ray_error.upper_95:.3f} mm"
    facts = _row("Predicted ray error", known)
    if newest.comparison is not None:
        facts += _moved(newest.comparison)
    path = f"/v1/calibrations/{escape(newest.id)}"
    return f"""
<h3>Newest calibration <time>{newest.created_at:%Y-%m-%d %H:%M} UTC</time></h3>
<div class="newest">
<a href="{path}/report.png"><img class="report" src="{path}/overlay.png" alt="Phantom with its outline"></a>
<div><table>{facts}</table>
<p><a href="{path}/report.png">Report picture</a> · <a href="{path}">All numbers</a></p>
{"" if active else _activate(newest.id, "Accept this calibration")}</div>
</div>"""


def _drift(look: Drift) -> str:
    tone, told = _seen(look)
    return (
        f'<p class="drift {tone}"><a href="/v1/drifts/{escape(look.id)}">Drift</a> '
        f"<time>{look.created_at:%Y-%m-%d %H:%M} UTC</time> {escape(told)}</p>"
    )


def _seen(look: Drift) -> tuple[str, str]:
    """A colour's name and what the log showed, or why it showed nothing."""
    result = look.result
    if result is None:
        return "watch", f"Could not be seen: {look.failure.detail if look.failure else look.state}"
    if result.within_tolerance is None:
        return "watch", f"Could not be seen: {result.reason}"
    word, tone = ("In tolerance", "good") if result.within_tolerance else ("Out of tolerance", "bad")
    moved = f"rays moved {result.ray_change_mm:.3f} mm RMS of {result.tolerance_mm:g} mm allowed"
    column, tilt = result.change.cor_column_mm, math.degrees(result.change.tilt_rad)
    return tone, f"{word}: {moved}, COR {column:+.3f} mm, tilt {tilt:+.3f}°; {result.reason}"


def _moved(comparison: Comparison) -> str:
    rows = {
        "Rays moved": f"{comparison.ray_change_mm:.3f} mm RMS",
        "Rotation centre on the detector": f"{comparison.cor_column_change_mm:+.3f} mm",
        "Source distance": f"{comparison.source_distance_change_mm:+.3f} mm",
        "Detector tilt": f"{comparison.tilt_change_deg:+.3f}°",
        "First angle": f"{comparison.angle_change_deg:+.3f}°",
    }
    against = f'<tr><th colspan="2" class="against">against {escape(comparison.calibration_id)}</th></tr>'
    return against + "".join(_row(name, value) for name, value in rows.items())


def _row(name: str, value: str) -> str:
    return f"<tr><th>{name}</th><td>{value}</td></tr>"


def _history(condition: ScannerCondition) -> str:
    if not condition.history:
        return ""
    current, *earlier = condition.history
    active = condition.scanner.active_calibration_id
    entries = _activation(current, "<em>active</em>") + "".join(
        _activation(entry, "" if entry.calibration_id == active else _activate(entry.calibration_id, "Roll back"))
        for entry in earlier
    )
    return f"<details><summary>History</summary><ul>{entries}</ul></details>"


def _activation(entry: Activation, standing: str) -> str:
    return (
        f"<li><time>{escape(entry.activated_at[:16].replace('T', ' '))}</time>"
        f'<a href="/v1/calibrations/{escape(entry.calibration_id)}">{escape(entry.calibration_id)}</a>'
        f"<span>{escape(entry.reason)}</span>{standing}</li>"
    )


def _activate(calibration_id: str, label: str) -> str:
    return f'<form method="post" action="/operator/activate/{escape(calibration_id)}"><button>{label}</button></form>'
