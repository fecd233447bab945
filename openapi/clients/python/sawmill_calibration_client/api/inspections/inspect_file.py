from http import HTTPStatus
from typing import Any

import httpx

from ... import errors
from ...client import AuthenticatedClient, Client
from ...models.data_kind import DataKind
from ...models.inspection import Inspection
from ...models.priority import Priority
from ...models.problem import Problem
from ...types import UNSET, File, Response, Unset


def _get_kwargs(
    *,
    body: File | Unset = UNSET,
    data: DataKind | Unset = UNSET,
    dataset: str | Unset = UNSET,
    angles_deg: str | Unset = UNSET,
    fresh: bool | Unset = False,
    name: str | Unset = "file",
    priority: Priority | Unset = UNSET,
    inspection_id: str | Unset = UNSET,
    upload_id: str | Unset = UNSET,
    idempotency_key: str | Unset = UNSET,
) -> dict[str, Any]:
    headers: dict[str, Any] = {}
    if not isinstance(idempotency_key, Unset):
        headers["Idempotency-Key"] = idempotency_key

    params: dict[str, Any] = {}

    json_data: str | Unset = UNSET
    if not isinstance(data, Unset):
        json_data = data.value

    params["data"] = json_data

    params["dataset"] = dataset

    params["angles_deg"] = angles_deg

    params["fresh"] = fresh

    params["name"] = name

    json_priority: str | Unset = UNSET
    if not isinstance(priority, Unset):
        json_priority = priority.value

    params["priority"] = json_priority

    params["inspection_id"] = inspection_id

    params["upload_id"] = upload_id

    params = {k: v for k, v in params.items() if v is not UNSET and v is not None}

    _kwargs: dict[str, Any] = {
        "method": "post",
        "url": "/v1/inspections",
        "params": params,
    }

    if not isinstance(body, Unset):
        _kwargs["content"] = body.payload
    headers["Content-Type"] = "application/octet-stream"

    _kwargs["headers"] = headers
    return _kwargs


def _parse_response(*, client: AuthenticatedClient | Client, response: httpx.Response) -> Inspection | Problem | None:
    if response.status_code == 202:
        response_202 = Inspection.from_dict(response.json())

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


def _build_response(
    *, client: AuthenticatedClient | Client, response: httpx.Response
) -> Response[Inspection | Problem]:
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
    data: DataKind | Unset = UNSET,
    dataset: str | Unset = UNSET,
    angles_deg: str | Unset = UNSET,
    fresh: bool | Unset = False,
    name: str | Unset = "file",
    priority: Priority | Unset = UNSET,
    inspection_id: str | Unset = UNSET,
    upload_id: str | Unset = UNSET,
    idempotency_key: str | Unset = UNSET,
) -> Response[Inspection | Problem]:
    """Inspect a file before it becomes a scan

     Send the file's bytes as the body; a job finds out what is in it, what of it would be read, and what
    is missing.

    What is missing stands there with the `field` of `POST /v1/scans` that gives it. Then `POST
    /v1/scans?inspection_id=…`
    with an empty body makes a scan of the file, which is not sent again; so does `POST
    /v1/inspections?inspection_id=…`
    to inspect it with another option. The file is kept for a day.
    [A file to try](/examples/phantom-scan.npz).

    Args:
        data (DataKind | Unset): What the numbers of a scan are. Never guessed.
        dataset (str | Unset): Path or variable of the projections, where the file holds several.
            Null: not given.
        angles_deg (str | Unset): START:STEP in degrees, or every view's angle separated by
            commas; where the file carries none.
        fresh (bool | Unset): Compute it even where the same was computed before, of the same
            input, with the same parameters and the same version of the software. Otherwise that
            result answers at once, and `answered_from` names it. Default: False.
        name (str | Unset): What people call the file. Default: 'file'.
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
        Response[Inspection | Problem]
    """

    kwargs = _get_kwargs(
        body=body,
        data=data,
        dataset=dataset,
        angles_deg=angles_deg,
        fresh=fresh,
        name=name,
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
    data: DataKind | Unset = UNSET,
    dataset: str | Unset = UNSET,
    angles_deg: str | Unset = UNSET,
    fresh: bool | Unset = False,
    name: str | Unset = "file",
    priority: Priority | Unset = UNSET,
    inspection_id: str | Unset = UNSET,
    upload_id: str | Unset = UNSET,
    idempotency_key: str | Unset = UNSET,
) -> Inspection | Problem | None:
    """Inspect a file before it becomes a scan

     Send the file's bytes as the body; a job finds out what is in it, what of it would be read, and what
    is missing.

    What is missing stands there with the `field` of `POST /v1/scans` that gives it. Then `POST
    /v1/scans?inspection_id=…`
    with an empty body makes a scan of the file, which is not sent again; so does `POST
    /v1/inspections?inspection_id=…`
    to inspect it with another option. The file is kept for a day.
    [A file to try](/examples/phantom-scan.npz).

    Args:
        data (DataKind | Unset): What the numbers of a scan are. Never guessed.
        dataset (str | Unset): Path or variable of the projections, where the file holds several.
            Null: not given.
        angles_deg (str | Unset): START:STEP in degrees, or every view's angle separated by
            commas; where the file carries none.
        fresh (bool | Unset): Compute it even where the same was computed before, of the same
            input, with the same parameters and the same version of the software. Otherwise that
            result answers at once, and `answered_from` names it. Default: False.
        name (str | Unset): What people call the file. Default: 'file'.
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
        Inspection | Problem
    """

    return sync_detailed(
        client=client,
        body=body,
        data=data,
        dataset=dataset,
        angles_deg=angles_deg,
        fresh=fresh,
        name=name,
        priority=priority,
        inspection_id=inspection_id,
        upload_id=upload_id,
        idempotency_key=idempotency_key,
    ).parsed


async def asyncio_detailed(
    *,
    client: AuthenticatedClient,
    body: File | Unset = UNSET,
    data: DataKind | Unset = UNSET,
    dataset: str | Unset = UNSET,
    angles_deg: str | Unset = UNSET,
    fresh: bool | Unset = False,
    name: str | Unset = "file",
    priority: Priority | Unset = UNSET,
    inspection_id: str | Unset = UNSET,
    upload_id: str | Unset = UNSET,
    idempotency_key: str | Unset = UNSET,
) -> Response[Inspection | Problem]:
    """Inspect a file before it becomes a scan

     Send the file's bytes as the body; a job finds out what is in it, what of it would be read, and what
    is missing.

    What is missing stands there with the `field` of `POST /v1/scans` that gives it. Then `POST
    /v1/scans?inspection_id=…`
    with an empty body makes a scan of the file, which is not sent again; so does `POST
    /v1/inspections?inspection_id=…`
    to inspect it with another option. The file is kept for a day.
    [A file to try](/examples/phantom-scan.npz).

    Args:
        data (DataKind | Unset): What the numbers of a scan are. Never guessed.
        dataset (str | Unset): Path or variable of the projections, where the file holds several.
            Null: not given.
        angles_deg (str | Unset): START:STEP in degrees, or every view's angle separated by
            commas; where the file carries none.
        fresh (bool | Unset): Compute it even where the same was computed before, of the same
            input, with the same parameters and the same version of the software. Otherwise that
            result answers at once, and `answered_from` names it. Default: False.
        name (str | Unset): What people call the file. Default: 'file'.
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
        Response[Inspection | Problem]
    """

    kwargs = _get_kwargs(
        body=body,
        data=data,
        dataset=dataset,
        angles_deg=angles_deg,
        fresh=fresh,
        name=name,
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
    data: DataKind | Unset = UNSET,
    dataset: str | Unset = UNSET,
    angles_deg: str | Unset = UNSET,
    fresh: bool | Unset = False,
    name: str | Unset = "file",
    priority: Priority | Unset = UNSET,
    inspection_id: str | Unset = UNSET,
    upload_id: str | Unset = UNSET,
    idempotency_key: str | Unset = UNSET,
) -> Inspection | Problem | None:
    """Inspect a file before it becomes a scan

     Send the file's bytes as the body; a job finds out what is in it, what of it would be read, and what
    is missing.

    What is missing stands there with the `field` of `POST /v1/scans` that gives it. Then `POST
    /v1/scans?inspection_id=…`
    with an empty body makes a scan of the file, which is not sent again; so does `POST
    /v1/inspections?inspection_id=…`
    to inspect it with another option. The file is kept for a day.
    [A file to try](/examples/phantom-scan.npz).

    Args:
        data (DataKind | Unset): What the numbers of a scan are. Never guessed.
        dataset (str | Unset): Path or variable of the projections, where the file holds several.
            Null: not given.
        angles_deg (str | Unset): START:STEP in degrees, or every view's angle separated by
            commas; where the file carries none.
        fresh (bool | Unset): Compute it even where the same was computed before, of the same
            input, with the same parameters and the same version of the software. Otherwise that
            result answers at once, and `answered_from` names it. Default: False.
        name (str | Unset): What people call the file. Default: 'file'.
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
        Inspection | Problem
    """

    return (
        await asyncio_detailed(
            client=client,
            body=body,
            data=data,
            dataset=dataset,
            angles_deg=angles_deg,
            fresh=fresh,
            name=name,
            priority=priority,
            inspection_id=inspection_id,
            upload_id=upload_id,
            idempotency_key=idempotency_key,
        )
    ).parsed
