from http import HTTPStatus
from typing import Any

import httpx

from ... import errors
from ...client import AuthenticatedClient, Client
from ...models.drift import Drift
from ...models.drift_ask import DriftAsk
from ...models.priority import Priority
from ...models.problem import Problem
from ...types import UNSET, Response, Unset


def _get_kwargs(
    *,
    body: DriftAsk,
    priority: Priority | Unset = UNSET,
    idempotency_key: str | Unset = UNSET,
) -> dict[str, Any]:
    headers: dict[str, Any] = {}
    if not isinstance(idempotency_key, Unset):
        headers["Idempotency-Key"] = idempotency_key

    params: dict[str, Any] = {}

    json_priority: str | Unset = UNSET
    if not isinstance(priority, Unset):
        json_priority = priority.value

    params["priority"] = json_priority

    params = {k: v for k, v in params.items() if v is not UNSET and v is not None}

    _kwargs: dict[str, Any] = {
        "method": "post",
        "url": "/v1/drifts",
        "params": params,
    }

    _kwargs["json"] = body.to_dict()

    headers["Content-Type"] = "application/json"

    _kwargs["headers"] = headers
    return _kwargs


def _parse_response(*, client: AuthenticatedClient | Client, response: httpx.Response) -> Drift | Problem | None:
    if response.status_code == 202:
        response_202 = Drift.from_dict(response.json())

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


def _build_response(*, client: AuthenticatedClient | Client, response: httpx.Response) -> Response[Drift | Problem]:
    return Response(
        status_code=HTTPStatus(response.status_code),
        content=response.content,
        headers=response.headers,
        parsed=_parse_response(client=client, response=response),
    )


def sync_detailed(
    *,
    client: AuthenticatedClient,
    body: DriftAsk,
    priority: Priority | Unset = UNSET,
    idempotency_key: str | Unset = UNSET,
) -> Response[Drift | Problem]:
    """Look for drift without a phantom

     What moved since a calibration, from any scan of a log with 8 views or more.

    In a scan that goes all round in steps of 3 degrees or less every ray is measured twice, from either
    side. In any other
    one the views are compared two by two: weighted sums of their rays must be the same. Where they
    agree shows where the
    centre of rotation falls on the detector, and the detector's tilt. The source's distance and the
    first angle cannot be
    seen.
    The scan's stack is not needed: the mean of its rows, posted as a scan with `averaged_rows`, is
    enough.
    The scan may still be read and the calibration still computed: the job waits for them.

    Args:
        priority (Priority | Unset): Which job comes first: somebody waits for it, it is one of
            many as of a schedule, or it is for idle times.
        idempotency_key (str | Unset): The client's own name for this request, as a UUID, in
            quotes or without: the same request with the same name makes nothing again within 48
            hours, and gets the first one's answer, with `Idempotency-Replayed: true`.
        body (DriftAsk): Ask whether a scanner has moved since a calibration. The scan needs 8
            views or more, of any log.

    Raises:
        errors.UnexpectedStatus: If the server returns an undocumented status code and Client.raise_on_unexpected_status is True.
        httpx.TimeoutException: If the request takes longer than Client.timeout.

    Returns:
        Response[Drift | Problem]
    """

    kwargs = _get_kwargs(
        body=body,
        priority=priority,
        idempotency_key=idempotency_key,
    )

    response = client.get_httpx_client().request(
        **kwargs,
    )

    return _build_response(client=client, response=response)


def sync(
    *,
    client: AuthenticatedClient,
    body: DriftAsk,
    priority: Priority | Unset = UNSET,
    idempotency_key: str | Unset = UNSET,
) -> Drift | Problem | None:
    """Look for drift without a phantom

     What moved since a calibration, from any scan of a log with 8 views or more.

    In a scan that goes all round in steps of 3 degrees or less every ray is measured twice, from either
    side. In any other
    one the views are compared two by two: weighted sums of their rays must be the same. Where they
    agree shows where the
    centre of rotation falls on the detector, and the detector's tilt. The source's distance and the
    first angle cannot be
    seen.
    The scan's stack is not needed: the mean of its rows, posted as a scan with `averaged_rows`, is
    enough.
    The scan may still be read and the calibration still computed: the job waits for them.

    Args:
        priority (Priority | Unset): Which job comes first: somebody waits for it, it is one of
            many as of a schedule, or it is for idle times.
        idempotency_key (str | Unset): The client's own name for this request, as a UUID, in
            quotes or without: the same request with the same name makes nothing again within 48
            hours, and gets the first one's answer, with `Idempotency-Replayed: true`.
        body (DriftAsk): Ask whether a scanner has moved since a calibration. The scan needs 8
            views or more, of any log.

    Raises:
        errors.UnexpectedStatus: If the server returns an undocumented status code and Client.raise_on_unexpected_status is True.
        httpx.TimeoutException: If the request takes longer than Client.timeout.

    Returns:
        Drift | Problem
    """

    return sync_detailed(
        client=client,
        body=body,
        priority=priority,
        idempotency_key=idempotency_key,
    ).parsed


async def asyncio_detailed(
    *,
    client: AuthenticatedClient,
    body: DriftAsk,
    priority: Priority | Unset = UNSET,
    idempotency_key: str | Unset = UNSET,
) -> Response[Drift | Problem]:
    """Look for drift without a phantom

     What moved since a calibration, from any scan of a log with 8 views or more.

    In a scan that goes all round in steps of 3 degrees or less every ray is measured twice, from either
    side. In any other
    one the views are compared two by two: weighted sums of their rays must be the same. Where they
    agree shows where the
    centre of rotation falls on the detector, and the detector's tilt. The source's distance and the
    first angle cannot be
    seen.
    The scan's stack is not needed: the mean of its rows, posted as a scan with `averaged_rows`, is
    enough.
    The scan may still be read and the calibration still computed: the job waits for them.

    Args:
        priority (Priority | Unset): Which job comes first: somebody waits for it, it is one of
            many as of a schedule, or it is for idle times.
        idempotency_key (str | Unset): The client's own name for this request, as a UUID, in
            quotes or without: the same request with the same name makes nothing again within 48
            hours, and gets the first one's answer, with `Idempotency-Replayed: true`.
        body (DriftAsk): Ask whether a scanner has moved since a calibration. The scan needs 8
            views or more, of any log.

    Raises:
        errors.UnexpectedStatus: If the server returns an undocumented status code and Client.raise_on_unexpected_status is True.
        httpx.TimeoutException: If the request takes longer than Client.timeout.

    Returns:
        Response[Drift | Problem]
    """

    kwargs = _get_kwargs(
        body=body,
        priority=priority,
        idempotency_key=idempotency_key,
    )

    response = await client.get_async_httpx_client().request(**kwargs)

    return _build_response(client=client, response=response)


async def asyncio(
    *,
    client: AuthenticatedClient,
    body: DriftAsk,
    priority: Priority | Unset = UNSET,
    idempotency_key: str | Unset = UNSET,
) -> Drift | Problem | None:
    """Look for drift without a phantom

     What moved since a calibration, from any scan of a log with 8 views or more.

    In a scan that goes all round in steps of 3 degrees or less every ray is measured twice, from either
    side. In any other
    one the views are compared two by two: weighted sums of their rays must be the same. Where they
    agree shows where the
    centre of rotation falls on the detector, and the detector's tilt. The source's distance and the
    first angle cannot be
    seen.
    The scan's stack is not needed: the mean of its rows, posted as a scan with `averaged_rows`, is
    enough.
    The scan may still be read and the calibration still computed: the job waits for them.

    Args:
        priority (Priority | Unset): Which job comes first: somebody waits for it, it is one of
            many as of a schedule, or it is for idle times.
        idempotency_key (str | Unset): The client's own name for this request, as a UUID, in
            quotes or without: the same request with the same name makes nothing again within 48
            hours, and gets the first one's answer, with `Idempotency-Replayed: true`.
        body (DriftAsk): Ask whether a scanner has moved since a calibration. The scan needs 8
            views or more, of any log.

    Raises:
        errors.UnexpectedStatus: If the server returns an undocumented status code and Client.raise_on_unexpected_status is True.
        httpx.TimeoutException: If the request takes longer than Client.timeout.

    Returns:
        Drift | Problem
    """

    return (
        await asyncio_detailed(
            client=client,
            body=body,
            priority=priority,
            idempotency_key=idempotency_key,
        )
    ).parsed
