from http import HTTPStatus
from typing import Any

import httpx

from ... import errors
from ...client import AuthenticatedClient, Client
from ...models.problem import Problem
from ...models.retention_preview import RetentionPreview
from ...types import UNSET, Response, Unset


def _get_kwargs(
    *,
    log_scans_days: int | Unset = UNSET,
    log_scans_bytes: int | Unset = UNSET,
    phantom_scans_days: int | Unset = UNSET,
    phantom_scans_bytes: int | Unset = UNSET,
    reconstructions_days: int | Unset = UNSET,
    reconstructions_bytes: int | Unset = UNSET,
    calibrations_days: int | Unset = UNSET,
    calibrations_bytes: int | Unset = UNSET,
    drifts_days: int | Unset = UNSET,
    inspections_days: int | Unset = UNSET,
    events_days: int | Unset = UNSET,
) -> dict[str, Any]:

    params: dict[str, Any] = {}

    params["log_scans_days"] = log_scans_days

    params["log_scans_bytes"] = log_scans_bytes

    params["phantom_scans_days"] = phantom_scans_days

    params["phantom_scans_bytes"] = phantom_scans_bytes

    params["reconstructions_days"] = reconstructions_days

    params["reconstructions_bytes"] = reconstructions_bytes

    params["calibrations_days"] = calibrations_days

    params["calibrations_bytes"] = calibrations_bytes

    params["drifts_days"] = drifts_days

    params["inspections_days"] = inspections_days

    params["events_days"] = events_days

    params = {k: v for k, v in params.items() if v is not UNSET and v is not None}

    _kwargs: dict[str, Any] = {
        "method": "get",
        "url": "/v1/retention/preview",
        "params": params,
    }

    return _kwargs


def _parse_response(
    *, client: AuthenticatedClient | Client, response: httpx.Response
) -> Problem | RetentionPreview | None:
    if response.status_code == 200:
        response_200 = RetentionPreview.from_dict(response.json())

        return response_200

    if response.status_code == 400:
        response_400 = Problem.from_dict(response.json())

        return response_400

    if response.status_code == 401:
        response_401 = Problem.from_dict(response.json())

        return response_401

    if response.status_code == 403:
        response_403 = Problem.from_dict(response.json())

        return response_403

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


def _build_response(
    *, client: AuthenticatedClient | Client, response: httpx.Response
) -> Response[Problem | RetentionPreview]:
    return Response(
        status_code=HTTPStatus(response.status_code),
        content=response.content,
        headers=response.headers,
        parsed=_parse_response(client=client, response=response),
    )


def sync_detailed(
    *,
    client: AuthenticatedClient,
    log_scans_days: int | Unset = UNSET,
    log_scans_bytes: int | Unset = UNSET,
    phantom_scans_days: int | Unset = UNSET,
    phantom_scans_bytes: int | Unset = UNSET,
    reconstructions_days: int | Unset = UNSET,
    reconstructions_bytes: int | Unset = UNSET,
    calibrations_days: int | Unset = UNSET,
    calibrations_bytes: int | Unset = UNSET,
    drifts_days: int | Unset = UNSET,
    inspections_days: int | Unset = UNSET,
    events_days: int | Unset = UNSET,
) -> Response[Problem | RetentionPreview]:
    """Show what would go by rules

     What would go by the rules of the query, or by those in force where it names none; nothing goes.

    An active calibration, the one before it and what they were made of never go; `stays` tells what
    else stays.

    Args:
        log_scans_days (int | Unset): Number of days after which a scan that names no phantom
            goes.
        log_scans_bytes (int | Unset): Bytes that scans without a phantom may have together,
            uploads included; the oldest go first.
        phantom_scans_days (int | Unset): Number of days after which a scan of a phantom goes.
        phantom_scans_bytes (int | Unset): Bytes that scans of phantoms may have together, uploads
            included; the oldest go first.
        reconstructions_days (int | Unset): Number of days after which a reconstruction goes.
        reconstructions_bytes (int | Unset): Bytes that reconstructions may have together; the
            oldest go first.
        calibrations_days (int | Unset): Number of days after which a calibration that was never
            active goes.
        calibrations_bytes (int | Unset): Bytes that calibrations may have together; the oldest go
            first.
        drifts_days (int | Unset): Number of days after which a drift check goes; what it measured
            stays.
        inspections_days (int | Unset): Number of days after which an inspection goes.
        events_days (int | Unset): Number of days after which an event goes.

    Raises:
        errors.UnexpectedStatus: If the server returns an undocumented status code and Client.raise_on_unexpected_status is True.
        httpx.TimeoutException: If the request takes longer than Client.timeout.

    Returns:
        Response[Problem | RetentionPreview]
    """

    kwargs = _get_kwargs(
        log_scans_days=log_scans_days,
        log_scans_bytes=log_scans_bytes,
        phantom_scans_days=phantom_scans_days,
        phantom_scans_bytes=phantom_scans_bytes,
        reconstructions_days=reconstructions_days,
        reconstructions_bytes=reconstructions_bytes,
        calibrations_days=calibrations_days,
        calibrations_bytes=calibrations_bytes,
        drifts_days=drifts_days,
        inspections_days=inspections_days,
        events_days=events_days,
    )

    response = client.get_httpx_client().request(
        **kwargs,
    )

    return _build_response(client=client, response=response)


def sync(
    *,
    client: AuthenticatedClient,
    log_scans_days: int | Unset = UNSET,
    log_scans_bytes: int | Unset = UNSET,
    phantom_scans_days: int | Unset = UNSET,
    phantom_scans_bytes: int | Unset = UNSET,
    reconstructions_days: int | Unset = UNSET,
    reconstructions_bytes: int | Unset = UNSET,
    calibrations_days: int | Unset = UNSET,
    calibrations_bytes: int | Unset = UNSET,
    drifts_days: int | Unset = UNSET,
    inspections_days: int | Unset = UNSET,
    events_days: int | Unset = UNSET,
) -> Problem | RetentionPreview | None:
    """Show what would go by rules

     What would go by the rules of the query, or by those in force where it names none; nothing goes.

    An active calibration, the one before it and what they were made of never go; `stays` tells what
    else stays.

    Args:
        log_scans_days (int | Unset): Number of days after which a scan that names no phantom
            goes.
        log_scans_bytes (int | Unset): Bytes that scans without a phantom may have together,
            uploads included; the oldest go first.
        phantom_scans_days (int | Unset): Number of days after which a scan of a phantom goes.
        phantom_scans_bytes (int | Unset): Bytes that scans of phantoms may have together, uploads
            included; the oldest go first.
        reconstructions_days (int | Unset): Number of days after which a reconstruction goes.
        reconstructions_bytes (int | Unset): Bytes that reconstructions may have together; the
            oldest go first.
        calibrations_days (int | Unset): Number of days after which a calibration that was never
            active goes.
        calibrations_bytes (int | Unset): Bytes that calibrations may have together; the oldest go
            first.
        drifts_days (int | Unset): Number of days after which a drift check goes; what it measured
            stays.
        inspections_days (int | Unset): Number of days after which an inspection goes.
        events_days (int | Unset): Number of days after which an event goes.

    Raises:
        errors.UnexpectedStatus: If the server returns an undocumented status code and Client.raise_on_unexpected_status is True.
        httpx.TimeoutException: If the request takes longer than Client.timeout.

    Returns:
        Problem | RetentionPreview
    """

    return sync_detailed(
        client=client,
        log_scans_days=log_scans_days,
        log_scans_bytes=log_scans_bytes,
        phantom_scans_days=phantom_scans_days,
        phantom_scans_bytes=phantom_scans_bytes,
        reconstructions_days=reconstructions_days,
        reconstructions_bytes=reconstructions_bytes,
        calibrations_days=calibrations_days,
        calibrations_bytes=calibrations_bytes,
        drifts_days=drifts_days,
        inspections_days=inspections_days,
        events_days=events_days,
    ).parsed


async def asyncio_detailed(
    *,
    client: AuthenticatedClient,
    log_scans_days: int | Unset = UNSET,
    log_scans_bytes: int | Unset = UNSET,
    phantom_scans_days: int | Unset = UNSET,
    phantom_scans_bytes: int | Unset = UNSET,
    reconstructions_days: int | Unset = UNSET,
    reconstructions_bytes: int | Unset = UNSET,
    calibrations_days: int | Unset = UNSET,
    calibrations_bytes: int | Unset = UNSET,
    drifts_days: int | Unset = UNSET,
    inspections_days: int | Unset = UNSET,
    events_days: int | Unset = UNSET,
) -> Response[Problem | RetentionPreview]:
    """Show what would go by rules

     What would go by the rules of the query, or by those in force where it names none; nothing goes.

    An active calibration, the one before it and what they were made of never go; `stays` tells what
    else stays.

    Args:
        log_scans_days (int | Unset): Number of days after which a scan that names no phantom
            goes.
        log_scans_bytes (int | Unset): Bytes that scans without a phantom may have together,
            uploads included; the oldest go first.
        phantom_scans_days (int | Unset): Number of days after which a scan of a phantom goes.
        phantom_scans_bytes (int | Unset): Bytes that scans of phantoms may have together, uploads
            included; the oldest go first.
        reconstructions_days (int | Unset): Number of days after which a reconstruction goes.
        reconstructions_bytes (int | Unset): Bytes that reconstructions may have together; the
            oldest go first.
        calibrations_days (int | Unset): Number of days after which a calibration that was never
            active goes.
        calibrations_bytes (int | Unset): Bytes that calibrations may have together; the oldest go
            first.
        drifts_days (int | Unset): Number of days after which a drift check goes; what it measured
            stays.
        inspections_days (int | Unset): Number of days after which an inspection goes.
        events_days (int | Unset): Number of days after which an event goes.

    Raises:
        errors.UnexpectedStatus: If the server returns an undocumented status code and Client.raise_on_unexpected_status is True.
        httpx.TimeoutException: If the request takes longer than Client.timeout.

    Returns:
        Response[Problem | RetentionPreview]
    """

    kwargs = _get_kwargs(
        log_scans_days=log_scans_days,
        log_scans_bytes=log_scans_bytes,
        phantom_scans_days=phantom_scans_days,
        phantom_scans_bytes=phantom_scans_bytes,
        reconstructions_days=reconstructions_days,
        reconstructions_bytes=reconstructions_bytes,
        calibrations_days=calibrations_days,
        calibrations_bytes=calibrations_bytes,
        drifts_days=drifts_days,
        inspections_days=inspections_days,
        events_days=events_days,
    )

    response = await client.get_async_httpx_client().request(**kwargs)

    return _build_response(client=client, response=response)


async def asyncio(
    *,
    client: AuthenticatedClient,
    log_scans_days: int | Unset = UNSET,
    log_scans_bytes: int | Unset = UNSET,
    phantom_scans_days: int | Unset = UNSET,
    phantom_scans_bytes: int | Unset = UNSET,
    reconstructions_days: int | Unset = UNSET,
    reconstructions_bytes: int | Unset = UNSET,
    calibrations_days: int | Unset = UNSET,
    calibrations_bytes: int | Unset = UNSET,
    drifts_days: int | Unset = UNSET,
    inspections_days: int | Unset = UNSET,
    events_days: int | Unset = UNSET,
) -> Problem | RetentionPreview | None:
    """Show what would go by rules

     What would go by the rules of the query, or by those in force where it names none; nothing goes.

    An active calibration, the one before it and what they were made of never go; `stays` tells what
    else stays.

    Args:
        log_scans_days (int | Unset): Number of days after which a scan that names no phantom
            goes.
        log_scans_bytes (int | Unset): Bytes that scans without a phantom may have together,
            uploads included; the oldest go first.
        phantom_scans_days (int | Unset): Number of days after which a scan of a phantom goes.
        phantom_scans_bytes (int | Unset): Bytes that scans of phantoms may have together, uploads
            included; the oldest go first.
        reconstructions_days (int | Unset): Number of days after which a reconstruction goes.
        reconstructions_bytes (int | Unset): Bytes that reconstructions may have together; the
            oldest go first.
        calibrations_days (int | Unset): Number of days after which a calibration that was never
            active goes.
        calibrations_bytes (int | Unset): Bytes that calibrations may have together; the oldest go
            first.
        drifts_days (int | Unset): Number of days after which a drift check goes; what it measured
            stays.
        inspections_days (int | Unset): Number of days after which an inspection goes.
        events_days (int | Unset): Number of days after which an event goes.

    Raises:
        errors.UnexpectedStatus: If the server returns an undocumented status code and Client.raise_on_unexpected_status is True.
        httpx.TimeoutException: If the request takes longer than Client.timeout.

    Returns:
        Problem | RetentionPreview
    """

    return (
        await asyncio_detailed(
            client=client,
            log_scans_days=log_scans_days,
            log_scans_bytes=log_scans_bytes,
            phantom_scans_days=phantom_scans_days,
            phantom_scans_bytes=phantom_scans_bytes,
            reconstructions_days=reconstructions_days,
            reconstructions_bytes=reconstructions_bytes,
            calibrations_days=calibrations_days,
            calibrations_bytes=calibrations_bytes,
            drifts_days=drifts_days,
            inspections_days=inspections_days,
            events_days=events_days,
        )
    ).parsed
