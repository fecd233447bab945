"""A scanner's history as CSV (RFC 4180): a line of column names, then a line for each entry."""

import csv
import io
from collections.abc import Iterable, Iterator

from sawmill_contracts.history import HistoryEntry

# A later version adds columns at the end. A name has its unit: `gain` of the contract, which is older, has none.
COLUMNS = (
    *("number", "at", "kind", "what", "subject", "subject_id", "link", "who", "key_id", "why", "alarm"),
    *("verdict", "rays_verdict", "within_tolerance", "against_id"),
    *("cor_column_mm", "cor_column_standard_deviation_mm", "cor_column_change_mm"),
    *("tilt_deg", "tilt_standard_deviation_deg", "tilt_change_deg"),
    *("source_to_detector_mm", "source_to_detector_standard_deviation_mm", "source_distance_mm"),
    *("relative_residual", "gain_per_mm"),
    *("ray_change_mm", "ray_change_tolerance_mm", "scale_change_percent"),
    *("ray_error_rms_mm", "ray_error_upper_95_mm", "scale_uncertainty_percent"),
    *("method", "cor_column_tilt_covariance_mm_deg", "baseline_looks", "baseline_age_hours"),
    *("cor_column_baseline_change_mm", "tilt_baseline_change_deg"),
    *("pooled_looks", "pooled_cor_column_mm", "pooled_cor_column_standard_deviation_mm"),
    *("pooled_tilt_deg", "pooled_tilt_standard_deviation_deg"),
)
# Spreadsheets take a text that begins with one of these as a formula (OWASP, CSV Injection).
_FORMULA = ("=", "+", "-", "@", "\t", "\r")


def history_csv(batches: Iterable[list[HistoryEntry]]) -> Iterator[str]:
    """Yield the text in parts: the line of names, then a part for each batch; at most one batch is in memory."""
    yield _lines([COLUMNS])
    for batch in batches:
        yield _lines(map(_values, batch))


def _values(entry: HistoryEntry) -> list[str]:
    of_entry = entry.model_dump(mode="json")
    measured = of_entry.pop("measured") or {}
    values = measured | of_entry | {"gain_per_mm": measured.get("gain")}
    return [_cell(values.get(name)) for name in COLUMNS]


def _cell(value: object) -> str:
    """Write a cell: a number as it is, a text that could be taken as a formula after an apostrophe."""
    if isinstance(value, str):
        return f"'{value}" if value.startswith(_FORMULA) else value
    if isinstance(value, bool):
        return "true" if value else "false"
    return "" if value is None else repr(value)


def _lines(rows: Iterable[Iterable[str]]) -> str:
    text = io.StringIO()
    csv.writer(text, lineterminator="\r\n").writerows(rows)
    return text.getvalue()
