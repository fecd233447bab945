"""/v1/scanners, and a scanner's history as CSV (RFC 4180)."""

import csv
import io
from collections.abc import Iterable, Iterator
from typing import Annotated

from fastapi import Depends, Query, Response
from fastapi.responses import StreamingResponse
from pydantic import Field

from sawmill_contracts.history import Activation, HistoryEntry, HistoryKind
from sawmill_contracts.measurements import Measurement
from sawmill_contracts.next_steps import NextStepAnswer
from sawmill_contracts.scanner_drift import ScannerDrift
from sawmill_contracts.scanners import ScannerRequest, StoredScanner
from sawmill_platform.contracts import patterns
from sawmill_platform.contracts.base import Identifier, Page
from sawmill_platform.contracts.given import Given, GivenTime
from sawmill_platform.contracts.keys import Scope
from sawmill_service.dependencies import TheStore
from sawmill_service.http.bodies.sent_json import Sent
from sawmill_service.http.document.described_answers import LOCATED, NAMED, refuses
from sawmill_service.http.document.old_names import ACTIVATIONS, OLD
from sawmill_service.http.document.openapi_document import trying
from sawmill_service.http.repeats import repeatable
from sawmill_service.http.responses.answers import NumberedPaging, Paging, cursor, of_type
from sawmill_service.http.responses.conditional import REPLACED, TAGGED, ThePrecondition, tagged
from sawmill_service.http.route_rules import Router
from sawmill_service.scanner_conditions import condition_of

router = Router(prefix="/v1/scanners", tags=["scanners"], reading=Scope.READ)


class Since(NumberedPaging):
    """Page of the measurements, and their beginning."""

    since: GivenTime | None = Field(
        None, description="Earliest time of the measurements, RFC 3339.", examples=["2026-03-01T00:00:00Z"]
    )


class HistoryFilter(Given):
    """Filter of the entries of a history."""

    kind: HistoryKind | None = Field(
        None, description="Kind of the entries. Default: all kinds.", examples=["calibration"]
    )
    since: GivenTime | None = Field(
        None, description="Earliest time of the entries, RFC 3339.", examples=["2026-03-01T00:00:00Z"]
    )
    until: GivenTime | None = Field(
        None,
        description="End of the entries' span of time, itself left out, RFC 3339.",
        examples=["2030-01-01T00:00:00Z"],
    )


class HistoryPaging(HistoryFilter, Paging):
    """Page of the entries of a history, and their filter."""

    after: str | None = cursor("1772429400000000.12", patterns.HISTORY_CURSOR)


Csv = of_type("text/csv", StreamingResponse)
EXAMPLE = {
    "name": "Line 2",
    "constants": {
        "source_to_cor_mm": 859.46,
        "num_detector_pixels": 768,
        "detector_pitch_mm": 1.502864583,
        "row_pitch_mm": 2.0,
    },
}


@router.post(
    "",
    needs=Scope.ACTIVATE,
    status_code=201,
    summary="Describe a scanner",
    openapi_extra=trying(body=EXAMPLE),
    responses=LOCATED | refuses("folder-refused"),
)
@repeatable
def create_scanner(spec: Sent[ScannerRequest], store: TheStore, response: Response) -> StoredScanner:
    """Describe a scanner by constants, search bounds and tolerances. All but name and constants has a default."""
    scanner = store.scanners.create(spec)
    response.headers["Location"] = f"/v1/scanners/{scanner.id}"
    return scanner


@router.get("", summary="List scanners, newest first", responses=refuses("invalid-cursor"))
def list_scanners(paging: Annotated[Paging, Query()], store: TheStore) -> Page[StoredScanner]:
    """List scanners, each with its active calibration."""
    return store.scanners.page(after=paging.after, limit=paging.limit)


@router.get("/{scanner_id}", summary="Get a scanner", responses=TAGGED | refuses("scanner-not-found"))
def get_scanner(scanner_id: Identifier, store: TheStore, response: Response) -> StoredScanner:
    """Return the scanner with the calibration that it uses."""
    return tagged(response, store.scanners.get(scanner_id))


@router.put(
    "/{scanner_id}",
    needs=Scope.ACTIVATE,
    summary="Replace a scanner's description",
    openapi_extra=trying(scanner_id="example-spare", body=EXAMPLE),
    responses=REPLACED | refuses("scanner-not-found", "folder-refused"),
)
def replace_scanner(
    scanner_id: Identifier,
    spec: Sent[ScannerRequest],
    store: TheStore,
    precondition: ThePrecondition,
    response: Response,
) -> StoredScanner:
    """Replace a scanner's description; existing results keep the constants that they were made with."""
    return tagged(response, store.scanners.update(scanner_id, spec, check=precondition))


@router.delete(
    "/{scanner_id}",
    needs=Scope.ADMIN,
    status_code=204,
    summary="Delete an unused scanner",
    openapi_extra=trying(scanner_id="example-spare"),
    responses=refuses("scanner-not-found", "scanner-in-use"),
)
def delete_scanner(scanner_id: Identifier, store: TheStore) -> None:
    """Delete a scanner. Refused (409) while scans, results or schedules refer to it."""
    store.scanners.delete(scanner_id)


@router.get(
    "/{scanner_id}/history",
    summary="List which calibrations were active",
    deprecated=True,
    dependencies=[Depends(ACTIVATIONS)],
    responses=OLD | refuses("scanner-not-found"),
)
def list_activations(scanner_id: Identifier, store: TheStore) -> list[Activation]:
    """List the newest 50, newest first. Use `history/entries` of the kind `activation` instead, which has pages."""
    return [Activation.of(entry) for entry in store.history.page(scanner_id, kind=HistoryKind.ACTIVATION).items]


@router.get(
    "/{scanner_id}/history/entries",
    summary="List a scanner's history, newest first",
    responses=refuses("scanner-not-found", "invalid-cursor"),
)
def list_history(
    scanner_id: Identifier, which: Annotated[HistoryPaging, Query()], store: TheStore
) -> Page[HistoryEntry]:
    """List calibrations, drift checks, activations, alarms and changes of settings, with who, why and measured values.

    Entries are kept when their subjects are deleted.
    """
    return store.history.page(scanner_id, **which.model_dump())


@router.get(
    "/{scanner_id}/history.csv",
    summary="Get a scanner's history as a file",
    response_class=Csv,
    responses=NAMED | refuses("scanner-not-found"),
)
def get_history_file(scanner_id: Identifier, which: Annotated[HistoryFilter, Query()], store: TheStore) -> Response:
    """Return the same entries, the oldest first, as CSV (RFC 4180) with one line of column names."""
    headers = {"Content-Disposition": f'attachment; filename="{scanner_id}-history.csv"', "Cache-Control": "no-store"}
    return Csv(history_csv(store.history.all(scanner_id, **which.model_dump())), headers=headers)


@router.get(
    "/{scanner_id}/measurements",
    summary="List what calibrations and drift checks measured",
    responses=refuses("scanner-not-found", "invalid-cursor"),
)
def list_measurements(scanner_id: Identifier, which: Annotated[Since, Query()], store: TheStore) -> Page[Measurement]:
    """List one entry for each that succeeded, newest first: changes of the rays, u_c and the tilt over months."""
    return store.measurements.page(scanner_id, since=which.since, after=which.after, limit=which.limit)


@router.get(
    "/{scanner_id}/next-step", summary="Get the next step with a scanner", responses=refuses("scanner-not-found")
)
def get_scanner_step(scanner_id: Identifier, store: TheStore) -> NextStepAnswer:
    """Return what a person does next, by the newest calibration, movement, failures, alarms and what is in use."""
    condition = condition_of(store, store.scanners.get(scanner_id))
    return condition.step.answer.model_copy(update={"known": condition.known})


@router.get(
    "/{scanner_id}/drift",
    summary="Get what a scanner's drift checks show together",
    responses=refuses("scanner-not-found"),
)
def get_scanner_drift(scanner_id: Identifier, store: TheStore) -> ScannerDrift:
    """Return baseline, newest checks pooled, and any jump or slow drift, all since the active calibration."""
    return store.drift_charts.of_scanner(scanner_id)


# A later version adds columns at the end. A name has its unit: `gain` of the contract, which is older, has none.
COLUMNS = (
    *("number", "at", "kind", "type", "subject", "subject_id", "link", "who", "key_id", "why", "alarm"),
    *("verdict", "rays_verdict", "within_tolerance", "against_id"),
    *("cor_column_mm", "cor_column_standard_deviation_mm", "cor_column_change_mm"),
    *("tilt_deg", "tilt_standard_deviation_deg", "tilt_change_deg"),
    *("source_to_detector_mm", "source_to_detector_standard_deviation_mm", "source_distance_mm"),
    *("relative_residual", "gain_per_mm"),
    *("ray_change_mm", "ray_change_tolerance_mm", "scale_change_percent"),
    *("ray_error_rms_mm", "ray_error_upper_95_mm", "scale_uncertainty_percent"),
    *("method", "cor_column_tilt_covariance_mm_deg", "baseline_checks", "baseline_age_hours"),
    *("cor_column_baseline_change_mm", "tilt_baseline_change_deg"),
    *("pooled_checks", "pooled_cor_column_mm", "pooled_cor_column_standard_deviation_mm"),
    *("pooled_tilt_deg", "pooled_tilt_standard_deviation_deg"),
)
# Spreadsheets take a text that begins with one of these as a formula (OWASP, CSV Injection).
_FORMULA = ("=", "+", "-", "@", "\t", "\r")


def history_csv(batches: Iterable[list[HistoryEntry]]) -> Iterator[str]:
    """Yield the text in parts: the line of names, then a part for each batch; at most one batch is in memory."""
    yield _lines([COLUMNS])
    yield from (_lines(map(_values, batch)) for batch in batches)


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
