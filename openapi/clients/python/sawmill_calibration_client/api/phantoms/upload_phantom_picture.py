from http import HTTPStatus
from typing import Any

import httpx

from ... import errors
from ...client import AuthenticatedClient, Client
from ...models.priority import Priority
from ...models.problem import Problem
from ...models.stored_phantom import StoredPhantom
from ...types import UNSET, File, Response, Unset


def _get_kwargs(
    *,
    body: File,
    name: str,
    width_mm: float,
    size_tolerance: float | Unset = 0.0015,
    priority: Priority | Unset = UNSET,
    upload_id: str | Unset = UNSET,
    idempotency_key: str | Unset = UNSET,
) -> dict[str, Any]:
    headers: dict[str, Any] = {}
    if not isinstance(idempotency_key, Unset):
        headers["Idempotency-Key"] = idempotency_key

    params: dict[str, Any] = {}

    params["name"] = name

    params["width_mm"] = width_mm

    params["size_tolerance"] = size_tolerance

    json_priority: str | Unset = UNSET
    if not isinstance(priority, Unset):
        json_priority = priority.value

    params["priority"] = json_priority

    params["upload_id"] = upload_id

    params = {k: v for k, v in params.items() if v is not UNSET and v is not None}

    _kwargs: dict[str, Any] = {
        "method": "post",
        "url": "/v1/phantoms/pictures",
        "params": params,
    }

    _kwargs["content"] = body.payload
    headers["Content-Type"] = "image/png"

    _kwargs["headers"] = headers
    return _kwargs


def _parse_response(
    *, client: AuthenticatedClient | Client, response: httpx.Response
) -> Problem | StoredPhantom | None:
    if response.status_code == 202:
        response_202 = StoredPhantom.from_dict(response.json())

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
) -> Response[Problem | StoredPhantom]:
    return Response(
        status_code=HTTPStatus(response.status_code),
        content=response.content,
        headers=response.headers,
        parsed=_parse_response(client=client, response=response),
    )


def sync_detailed(
    *,
    client: AuthenticatedClient,
    body: File,
    name: str,
    width_mm: float,
    size_tolerance: float | Unset = 0.0015,
    priority: Priority | Unset = UNSET,
    upload_id: str | Unset = UNSET,
    idempotency_key: str | Unset = UNSET,
) -> Response[Problem | StoredPhantom]:
    """Upload a phantom's picture

     Send a PNG as the body; a job traces its outlines.

    Bright is wood. A row of the picture is +x, a column +y, its centre the rotation centre.
    [A picture to try](/static/phantom.png) (400 mm wide).

    Args:
        name (str): What people call it.
        width_mm (float): Of the whole picture, mm.
        size_tolerance (float | Unset): Relative standard uncertainty of the stated size, no unit.
            Default: 0.0015.
        priority (Priority | Unset): Which job comes first: somebody waits for it, it is one of
            many as of a schedule, or it is for idle times.
        upload_id (str | Unset): Takes this upload, which came in parts: the body is empty, and
            the upload is used up.
        idempotency_key (str | Unset): The client's own name for this request, as a UUID, in
            quotes or without: the same request with the same name makes nothing again within 48
            hours, and gets the first one's answer, with `Idempotency-Replayed: true`.
        body (File):

    Raises:
        errors.UnexpectedStatus: If the server returns an undocumented status code and Client.raise_on_unexpected_status is True.
        httpx.TimeoutException: If the request takes longer than Client.timeout.

    Returns:
        Response[Problem | StoredPhantom]
    """

    kwargs = _get_kwargs(
        body=body,
        name=name,
        width_mm=width_mm,
        size_tolerance=size_tolerance,
        priority=priority,
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
    body: File,
    name: str,
    width_mm: float,
    size_tolerance: float | Unset = 0.0015,
    priority: Priority | Unset = UNSET,
    upload_id: str | Unset = UNSET,
    idempotency_key: str | Unset = UNSET,
) -> Problem | StoredPhantom | None:
    """Upload a phantom's picture

     Send a PNG as the body; a job traces its outlines.

    Bright is wood. A row of the picture is +x, a column +y, its centre the rotation centre.
    [A picture to try](/static/phantom.png) (400 mm wide).

    Args:
        name (str): What people call it.
        width_mm (float): Of the whole picture, mm.
        size_tolerance (float | Unset): Relative standard uncertainty of the stated size, no unit.
            Default: 0.0015.
        priority (Priority | Unset): Which job comes first: somebody waits for it, it is one of
            many as of a schedule, or it is for idle times.
        upload_id (str | Unset): Takes this upload, which came in parts: the body is empty, and
            the upload is used up.
        idempotency_key (str | Unset): The client's own name for this request, as a UUID, in
            quotes or without: the same request with the same name makes nothing again within 48
            hours, and gets the first one's answer, with `Idempotency-Replayed: true`.
        body (File):

    Raises:
        errors.UnexpectedStatus: If the server returns an undocumented status code and Client.raise_on_unexpected_status is True.
        httpx.TimeoutException: If the request takes longer than Client.timeout.

    Returns:
        Problem | StoredPhantom
    """

    return sync_detailed(
        client=client,
        body=body,
        name=name,
        width_mm=width_mm,
        size_tolerance=size_tolerance,
        priority=priority,
        upload_id=upload_id,
        idempotency_key=idempotency_key,
    ).parsed


async def asyncio_detailed(
    *,
    client: AuthenticatedClient,
    body: File,
    name: str,
    width_mm: float,
    size_tolerance: float | Unset = 0.0015,
    priority: Priority | Unset = UNSET,
    upload_id: str | Unset = UNSET,
    idempotency_key: str | Unset = UNSET,
) -> Response[Problem | StoredPhantom]:
    """Upload a phantom's picture

     Send a PNG as the body; a job traces its outlines.

    Bright is wood. A row of the picture is +x, a column +y, its centre the rotation centre.
    [A picture to try](/static/phantom.png) (400 mm wide).

    Args:
        name (str): What people call it.
        width_mm (float): Of the whole picture, mm.
        size_tolerance (float | Unset): Relative standard uncertainty of the stated size, no unit.
            Default: 0.0015.
        priority (Priority | Unset): Which job comes first: somebody waits for it, it is one of
            many as of a schedule, or it is for idle times.
        upload_id (str | Unset): Takes this upload, which came in parts: the body is empty, and
            the upload is used up.
        idempotency_key (str | Unset): The client's own name for this request, as a UUID, in
            quotes or without: the same request with the same name makes nothing again within 48
            hours, and gets the first one's answer, with `Idempotency-Replayed: true`.
        body (File):

    Raises:
        errors.UnexpectedStatus: If the server returns an undocumented status code and Client.raise_on_unexpected_status is True.
        httpx.TimeoutException: If the request takes longer than Client.timeout.

    Returns:
        Response[Problem | StoredPhantom]
    """

    kwargs = _get_kwargs(
        body=body,
        name=name,
        width_mm=width_mm,
        size_tolerance=size_tolerance,
        priority=priority,
        upload_id=upload_id,
        idempotency_key=idempotency_key,
    )

    response = await client.get_async_httpx_client().request(**kwargs)

    return _build_response(client=client, response=response)


async def asyncio(
    *,
    client: AuthenticatedClient,
    body: File,
    name: str,
    width_mm: float,
    size_tolerance: float | Unset = 0.0015,
    priority: Priority | Unset = UNSET,
    upload_id: str | Unset = UNSET,
    idempotency_key: str | Unset = UNSET,
) -> Problem | StoredPhantom | None:
    """Upload a phantom's picture

     Send a PNG as the body; a job traces its outlines.

    Bright is wood. A row of the picture is +x, a column +y, its centre the rotation centre.
    [A picture to try](/static/phantom.png) (400 mm wide).

    Args:
        name (str): What people call it.
        width_mm (float): Of the whole picture, mm.
        size_tolerance (float | Unset): Relative standard uncertainty of the stated size, no unit.
            Default: 0.0015.
        priority (Priority | Unset): Which job comes first: somebody waits for it, it is one of
            many as of a schedule, or it is for idle times.
        upload_id (str | Unset): Takes this upload, which came in parts: the body is empty, and
            the upload is used up.
        idempotency_key (str | Unset): The client's own name for this request, as a UUID, in
            quotes or without: the same request with the same name makes nothing again within 48
            hours, and gets the first one's answer, with `Idempotency-Replayed: true`.
        body (File):

    Raises:
        errors.UnexpectedStatus: If the server returns an undocumented status code and Client.raise_on_unexpected_status is True.
        httpx.TimeoutException: If the request takes longer than Client.timeout.

    Returns:
        Problem | StoredPhantom
    """

    return (
        await asyncio_detailed(
            client=client,
            body=body,
            name=name,
            width_mm=width_mm,
            size_tolerance=size_tolerance,
            priority=priority,
            upload_id=upload_id,
            idempotency_key=idempotency_key,
        )
    ).parsed
