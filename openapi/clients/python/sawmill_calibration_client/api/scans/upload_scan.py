from http import HTTPStatus
from typing import Any

import httpx

from ... import errors
from ...client import AuthenticatedClient, Client
from ...models.air_correction import AirCorrection
from ...models.data_kind import DataKind
from ...models.faulty_cells import FaultyCells
from ...models.priority import Priority
from ...models.problem import Problem
from ...models.ring_removal import RingRemoval
from ...models.row_alignment import RowAlignment
from ...models.scan import Scan
from ...types import UNSET, File, Response, Unset


def _get_kwargs(
    *,
    body: File | Unset = UNSET,
    air: AirCorrection | Unset = UNSET,
    faulty_cells: FaultyCells | Unset = UNSET,
    rings: RingRemoval | Unset = UNSET,
    align_rows: RowAlignment | Unset = UNSET,
    data: DataKind,
    dataset: str | Unset = UNSET,
    angles_deg: str | Unset = UNSET,
    averaged_rows: int | Unset = UNSET,
    scanner_id: str,
    name: str | Unset = "scan",
    phantom_id: str | Unset = UNSET,
    phantom_rows: str | Unset = UNSET,
    priority: Priority | Unset = UNSET,
    inspection_id: str | Unset = UNSET,
    upload_id: str | Unset = UNSET,
    idempotency_key: str | Unset = UNSET,
) -> dict[str, Any]:
    headers: dict[str, Any] = {}
    if not isinstance(idempotency_key, Unset):
        headers["Idempotency-Key"] = idempotency_key

    params: dict[str, Any] = {}

    json_air: str | Unset = UNSET
    if not isinstance(air, Unset):
        json_air = air.value

    params["air"] = json_air

    json_faulty_cells: str | Unset = UNSET
    if not isinstance(faulty_cells, Unset):
        json_faulty_cells = faulty_cells.value

    params["faulty_cells"] = json_faulty_cells

    json_rings: str | Unset = UNSET
    if not isinstance(rings, Unset):
        json_rings = rings.value

    params["rings"] = json_rings

    json_align_rows: str | Unset = UNSET
    if not isinstance(align_rows, Unset):
        json_align_rows = align_rows.value

    params["align_rows"] = json_align_rows

    json_data = data.value
    params["data"] = json_data

    params["dataset"] = dataset

    params["angles_deg"] = angles_deg

    params["averaged_rows"] = averaged_rows

    params["scanner_id"] = scanner_id

    params["name"] = name

    params["phantom_id"] = phantom_id

    params["phantom_rows"] = phantom_rows

    json_priority: str | Unset = UNSET
    if not isinstance(priority, Unset):
        json_priority = priority.value

    params["priority"] = json_priority

    params["inspection_id"] = inspection_id

    params["upload_id"] = upload_id

    params = {k: v for k, v in params.items() if v is not UNSET and v is not None}

    _kwargs: dict[str, Any] = {
        "method": "post",
        "url": "/v1/scans",
        "params": params,
    }

    if not isinstance(body, Unset):
        _kwargs["content"] = body.payload
    headers["Content-Type"] = "application/octet-stream"

    _kwargs["headers"] = headers
    return _kwargs


def _parse_response(*, client: AuthenticatedClient | Client, response: httpx.Response) -> Problem | Scan | None:
    if response.status_code == 202:
        response_202 = Scan.from_dict(response.json())

        return response_202

    if response.status_code == 400:
        response_400 = Problem.from_dict(response.json())

        return response_400

    if response.status_code == 401:
        response_401 = Problem.from_dict(response.json())

        return response_401

    if response.status_code == 403:
        response_403 = Problem.from_dict(response.json())

        return response_403

    if response.status_code == 404:
        response_404 = Problem.from_dict(response.json())

        return response_404

    if response.status_code == 408:
        response_408 = Problem.from_dict(response.json())

        return response_408

    if response.status_code == 409:
        response_409 = Problem.from_dict(response.json())

        return response_409

    if response.status_code == 413:
        response_413 = Problem.from_dict(response.json())

        return response_413

    if response.status_code == 415:
        response_415 = Problem.from_dict(response.json())

        return response_415

    if response.status_code == 421:
        response_421 = Problem.from_dict(response.json())

        return response_421

    if response.status_code == 422:
        response_422 = Problem.from_dict(response.json())

        return response_422

    if response.status_code == 429:
        response_429 = Problem.from_dict(response.json())

        return response_429

    if response.status_code == 431:
        response_431 = Problem.from_dict(response.json())

        return response_431

    if response.status_code == 500:
        response_500 = Problem.from_dict(response.json())

        return response_500

    if response.status_code == 503:
        response_503 = Problem.from_dict(response.json())

        return response_503

    if response.status_code == 507:
        response_507 = Problem.from_dict(response.json())

        return response_507

    if client.raise_on_unexpected_status:
        raise errors.UnexpectedStatus(response.status_code, response.content)
    else:
        return None


def _build_response(*, client: AuthenticatedClient | Client, response: httpx.Response) -> Response[Problem | Scan]:
    return Response(
        status_code=HTTPStatus(response.status_code),
        content=response.content,
        headers=response.headers,
        parsed=_parse_response(client=client, response=response),
    )


def sync_detailed(
    *,
    client: AuthenticatedClient,
    body: File | Unset = UNSET,
    air: AirCorrection | Unset = UNSET,
    faulty_cells: FaultyCells | Unset = UNSET,
    rings: RingRemoval | Unset = UNSET,
    align_rows: RowAlignment | Unset = UNSET,
    data: DataKind,
    dataset: str | Unset = UNSET,
    angles_deg: str | Unset = UNSET,
    averaged_rows: int | Unset = UNSET,
    scanner_id: str,
    name: str | Unset = "scan",
    phantom_id: str | Unset = UNSET,
    phantom_rows: str | Unset = UNSET,
    priority: Priority | Unset = UNSET,
    inspection_id: str | Unset = UNSET,
    upload_id: str | Unset = UNSET,
    idempotency_key: str | Unset = UNSET,
) -> Response[Problem | Scan]:
    """Upload a scan

     Send the file's bytes as the body, or name an inspection of it; a job reads it.

    HDF5 (NXtomo, Data Exchange), TIFF or a ZIP of TIFFs, NPY, NPZ and MAT are recognised by their
    content.
    For a drift check the mean of a log's rows is enough: line integrals (views, detector), with
    `averaged_rows`.
    `GET` the scan until its state is `ready`, or `refused` with the reason.
    [A file to try](/examples/phantom-scan.npz): counts with flat and dark fields and angles.

    Args:
        air (AirCorrection | Unset): What the air at the detector's ends takes out of the line
            integrals.

            `background` is one constant for a row. `views` is each view's level where it drifts, else
            the constant. `auto` is
            `views` for counts and `off` for line integrals.
        faulty_cells (FaultyCells | Unset): What becomes of dead and hot detector cells.
        rings (RingRemoval | Unset): How rings are taken out.
        align_rows (RowAlignment | Unset): How views that lost rows are aligned along the log.
        data (DataKind): What the numbers of a scan are. Never guessed.
        dataset (str | Unset): Path or variable of the projections, where the file holds several.
            Null: not given.
        angles_deg (str | Unset): START:STEP in degrees, or every view's angle separated by
            commas; where the file carries none.
        averaged_rows (int | Unset): The file is (views, detector): each line integral is the mean
            over this number of detector rows. NaN masks a ray; an array `deviations` beside them, in
            NPZ, MAT or HDF5, has their standard deviations. Null: rows as they were measured.
        scanner_id (str): Id of the scanner that made it.
        name (str | Unset): What people call it. Default: 'scan'.
        phantom_id (str | Unset): The phantom in this scan; null for a scan without one.
        phantom_rows (str | Unset): The rows that show the phantom; null: they are found.
        priority (Priority | Unset): Which job comes first: somebody waits for it, it is one of
            many as of a schedule, or it is for idle times.
        inspection_id (str | Unset): Takes the file of this inspection: the body is empty, and
            nothing is sent again.
        upload_id (str | Unset): Takes this upload, which came in parts: the body is empty, and
            the upload is used up.
        idempotency_key (str | Unset): The client's own name for this request, as a UUID, in
            quotes or without: the same request with the same name makes nothing again within 48
            hours, and gets the first one's answer, with `Idempotency-Replayed: true`.
        body (File | Unset):

    Raises:
        errors.UnexpectedStatus: If the server returns an undocumented status code and Client.raise_on_unexpected_status is True.
        httpx.TimeoutException: If the request takes longer than Client.timeout.

    Returns:
        Response[Problem | Scan]
    """

    kwargs = _get_kwargs(
        body=body,
        air=air,
        faulty_cells=faulty_cells,
        rings=rings,
        align_rows=align_rows,
        data=data,
        dataset=dataset,
        angles_deg=angles_deg,
        averaged_rows=averaged_rows,
        scanner_id=scanner_id,
        name=name,
        phantom_id=phantom_id,
        phantom_rows=phantom_rows,
        priority=priority,
        inspection_id=inspection_id,
        upload_id=upload_id,
        idempotency_key=idempotency_key,
    )

    response = client.get_httpx_client().request(
        **kwargs,
    )

    return _build_response(client=client, response=response)


def sync(
    *,
    client: AuthenticatedClient,
    body: File | Unset = UNSET,
    air: AirCorrection | Unset = UNSET,
    faulty_cells: FaultyCells | Unset = UNSET,
    rings: RingRemoval | Unset = UNSET,
    align_rows: RowAlignment | Unset = UNSET,
    data: DataKind,
    dataset: str | Unset = UNSET,
    angles_deg: str | Unset = UNSET,
    averaged_rows: int | Unset = UNSET,
    scanner_id: str,
    name: str | Unset = "scan",
    phantom_id: str | Unset = UNSET,
    phantom_rows: str | Unset = UNSET,
    priority: Priority | Unset = UNSET,
    inspection_id: str | Unset = UNSET,
    upload_id: str | Unset = UNSET,
    idempotency_key: str | Unset = UNSET,
) -> Problem | Scan | None:
    """Upload a scan

     Send the file's bytes as the body, or name an inspection of it; a job reads it.

    HDF5 (NXtomo, Data Exchange), TIFF or a ZIP of TIFFs, NPY, NPZ and MAT are recognised by their
    content.
    For a drift check the mean of a log's rows is enough: line integrals (views, detector), with
    `averaged_rows`.
    `GET` the scan until its state is `ready`, or `refused` with the reason.
    [A file to try](/examples/phantom-scan.npz): counts with flat and dark fields and angles.

    Args:
        air (AirCorrection | Unset): What the air at the detector's ends takes out of the line
            integrals.

            `background` is one constant for a row. `views` is each view's level where it drifts, else
            the constant. `auto` is
            `views` for counts and `off` for line integrals.
        faulty_cells (FaultyCells | Unset): What becomes of dead and hot detector cells.
        rings (RingRemoval | Unset): How rings are taken out.
        align_rows (RowAlignment | Unset): How views that lost rows are aligned along the log.
        data (DataKind): What the numbers of a scan are. Never guessed.
        dataset (str | Unset): Path or variable of the projections, where the file holds several.
            Null: not given.
        angles_deg (str | Unset): START:STEP in degrees, or every view's angle separated by
            commas; where the file carries none.
        averaged_rows (int | Unset): The file is (views, detector): each line integral is the mean
            over this number of detector rows. NaN masks a ray; an array `deviations` beside them, in
            NPZ, MAT or HDF5, has their standard deviations. Null: rows as they were measured.
        scanner_id (str): Id of the scanner that made it.
        name (str | Unset): What people call it. Default: 'scan'.
        phantom_id (str | Unset): The phantom in this scan; null for a scan without one.
        phantom_rows (str | Unset): The rows that show the phantom; null: they are found.
        priority (Priority | Unset): Which job comes first: somebody waits for it, it is one of
            many as of a schedule, or it is for idle times.
        inspection_id (str | Unset): Takes the file of this inspection: the body is empty, and
            nothing is sent again.
        upload_id (str | Unset): Takes this upload, which came in parts: the body is empty, and
            the upload is used up.
        idempotency_key (str | Unset): The client's own name for this request, as a UUID, in
            quotes or without: the same request with the same name makes nothing again within 48
            hours, and gets the first one's answer, with `Idempotency-Replayed: true`.
        body (File | Unset):

    Raises:
        errors.UnexpectedStatus: If the server returns an undocumented status code and Client.raise_on_unexpected_status is True.
        httpx.TimeoutException: If the request takes longer than Client.timeout.

    Returns:
        Problem | Scan
    """

    return sync_detailed(
        client=client,
        body=body,
        air=air,
        faulty_cells=faulty_cells,
        rings=rings,
        align_rows=align_rows,
        data=data,
        dataset=dataset,
        angles_deg=angles_deg,
        averaged_rows=averaged_rows,
        scanner_id=scanner_id,
        name=name,
        phantom_id=phantom_id,
        phantom_rows=phantom_rows,
        priority=priority,
        inspection_id=inspection_id,
        upload_id=upload_id,
        idempotency_key=idempotency_key,
    ).parsed


async def asyncio_detailed(
    *,
    client: AuthenticatedClient,
    body: File | Unset = UNSET,
    air: AirCorrection | Unset = UNSET,
    faulty_cells: FaultyCells | Unset = UNSET,
    rings: RingRemoval | Unset = UNSET,
    align_rows: RowAlignment | Unset = UNSET,
    data: DataKind,
    dataset: str | Unset = UNSET,
    angles_deg: str | Unset = UNSET,
    averaged_rows: int | Unset = UNSET,
    scanner_id: str,
    name: str | Unset = "scan",
    phantom_id: str | Unset = UNSET,
    phantom_rows: str | Unset = UNSET,
    priority: Priority | Unset = UNSET,
    inspection_id: str | Unset = UNSET,
    upload_id: str | Unset = UNSET,
    idempotency_key: str | Unset = UNSET,
) -> Response[Problem | Scan]:
    """Upload a scan

     Send the file's bytes as the body, or name an inspection of it; a job reads it.

    HDF5 (NXtomo, Data Exchange), TIFF or a ZIP of TIFFs, NPY, NPZ and MAT are recognised by their
    content.
    For a drift check the mean of a log's rows is enough: line integrals (views, detector), with
    `averaged_rows`.
    `GET` the scan until its state is `ready`, or `refused` with the reason.
    [A file to try](/examples/phantom-scan.npz): counts with flat and dark fields and angles.

    Args:
        air (AirCorrection | Unset): What the air at the detector's ends takes out of the line
            integrals.

            `background` is one constant for a row. `views` is each view's level where it drifts, else
            the constant. `auto` is
            `views` for counts and `off` for line integrals.
        faulty_cells (FaultyCells | Unset): What becomes of dead and hot detector cells.
        rings (RingRemoval | Unset): How rings are taken out.
        align_rows (RowAlignment | Unset): How views that lost rows are aligned along the log.
        data (DataKind): What the numbers of a scan are. Never guessed.
        dataset (str | Unset): Path or variable of the projections, where the file holds several.
            Null: not given.
        angles_deg (str | Unset): START:STEP in degrees, or every view's angle separated by
            commas; where the file carries none.
        averaged_rows (int | Unset): The file is (views, detector): each line integral is the mean
            over this number of detector rows. NaN masks a ray; an array `deviations` beside them, in
            NPZ, MAT or HDF5, has their standard deviations. Null: rows as they were measured.
        scanner_id (str): Id of the scanner that made it.
        name (str | Unset): What people call it. Default: 'scan'.
        phantom_id (str | Unset): The phantom in this scan; null for a scan without one.
        phantom_rows (str | Unset): The rows that show the phantom; null: they are found.
        priority (Priority | Unset): Which job comes first: somebody waits for it, it is one of
            many as of a schedule, or it is for idle times.
        inspection_id (str | Unset): Takes the file of this inspection: the body is empty, and
            nothing is sent again.
        upload_id (str | Unset): Takes this upload, which came in parts: the body is empty, and
            the upload is used up.
        idempotency_key (str | Unset): The client's own name for this request, as a UUID, in
            quotes or without: the same request with the same name makes nothing again within 48
            hours, and gets the first one's answer, with `Idempotency-Replayed: true`.
        body (File | Unset):

    Raises:
        errors.UnexpectedStatus: If the server returns an undocumented status code and Client.raise_on_unexpected_status is True.
        httpx.TimeoutException: If the request takes longer than Client.timeout.

    Returns:
        Response[Problem | Scan]
    """

    kwargs = _get_kwargs(
        body=body,
        air=air,
        faulty_cells=faulty_cells,
        rings=rings,
        align_rows=align_rows,
        data=data,
        dataset=dataset,
        angles_deg=angles_deg,
        averaged_rows=averaged_rows,
        scanner_id=scanner_id,
        name=name,
        phantom_id=phantom_id,
        phantom_rows=phantom_rows,
        priority=priority,
        inspection_id=inspection_id,
        upload_id=upload_id,
        idempotency_key=idempotency_key,
    )

    response = await client.get_async_httpx_client().request(**kwargs)

    return _build_response(client=client, response=response)


async def asyncio(
    *,
    client: AuthenticatedClient,
    body: File | Unset = UNSET,
    air: AirCorrection | Unset = UNSET,
    faulty_cells: FaultyCells | Unset = UNSET,
    rings: RingRemoval | Unset = UNSET,
    align_rows: RowAlignment | Unset = UNSET,
    data: DataKind,
    dataset: str | Unset = UNSET,
    angles_deg: str | Unset = UNSET,
    averaged_rows: int | Unset = UNSET,
    scanner_id: str,
    name: str | Unset = "scan",
    phantom_id: str | Unset = UNSET,
    phantom_rows: str | Unset = UNSET,
    priority: Priority | Unset = UNSET,
    inspection_id: str | Unset = UNSET,
    upload_id: str | Unset = UNSET,
    idempotency_key: str | Unset = UNSET,
) -> Problem | Scan | None:
    """Upload a scan

     Send the file's bytes as the body, or name an inspection of it; a job reads it.

    HDF5 (NXtomo, Data Exchange), TIFF or a ZIP of TIFFs, NPY, NPZ and MAT are recognised by their
    content.
    For a drift check the mean of a log's rows is enough: line integrals (views, detector), with
    `averaged_rows`.
    `GET` the scan until its state is `ready`, or `refused` with the reason.
    [A file to try](/examples/phantom-scan.npz): counts with flat and dark fields and angles.

    Args:
        air (AirCorrection | Unset): What the air at the detector's ends takes out of the line
            integrals.

            `background` is one constant for a row. `views` is each view's level where it drifts, else
            the constant. `auto` is
            `views` for counts and `off` for line integrals.
        faulty_cells (FaultyCells | Unset): What becomes of dead and hot detector cells.
        rings (RingRemoval | Unset): How rings are taken out.
        align_rows (RowAlignment | Unset): How views that lost rows are aligned along the log.
        data (DataKind): What the numbers of a scan are. Never guessed.
        dataset (str | Unset): Path or variable of the projections, where the file holds several.
            Null: not given.
        angles_deg (str | Unset): START:STEP in degrees, or every view's angle separated by
            commas; where the file carries none.
        averaged_rows (int | Unset): The file is (views, detector): each line integral is the mean
            over this number of detector rows. NaN masks a ray; an array `deviations` beside them, in
            NPZ, MAT or HDF5, has their standard deviations. Null: rows as they were measured.
        scanner_id (str): Id of the scanner that made it.
        name (str | Unset): What people call it. Default: 'scan'.
        phantom_id (str | Unset): The phantom in this scan; null for a scan without one.
        phantom_rows (str | Unset): The rows that show the phantom; null: they are found.
        priority (Priority | Unset): Which job comes first: somebody waits for it, it is one of
            many as of a schedule, or it is for idle times.
        inspection_id (str | Unset): Takes the file of this inspection: the body is empty, and
            nothing is sent again.
        upload_id (str | Unset): Takes this upload, which came in parts: the body is empty, and
            the upload is used up.
        idempotency_key (str | Unset): The client's own name for this request, as a UUID, in
            quotes or without: the same request with the same name makes nothing again within 48
            hours, and gets the first one's answer, with `Idempotency-Replayed: true`.
        body (File | Unset):

    Raises:
        errors.UnexpectedStatus: If the server returns an undocumented status code and Client.raise_on_unexpected_status is True.
        httpx.TimeoutException: If the request takes longer than Client.timeout.

    Returns:
        Problem | Scan
    """

    return (
        await asyncio_detailed(
            client=client,
            body=body,
            air=air,
            faulty_cells=faulty_cells,
            rings=rings,
            align_rows=align_rows,
            data=data,
            dataset=dataset,
            angles_deg=angles_deg,
            averaged_rows=averaged_rows,
            scanner_id=scanner_id,
            name=name,
            phantom_id=phantom_id,
            phantom_rows=phantom_rows,
            priority=priority,
            inspection_id=inspection_id,
            upload_id=upload_id,
            idempotency_key=idempotency_key,
        )
    ).parsed
