from http import HTTPStatus
from typing import Any
from urllib.parse import quote

import httpx

from ... import errors
from ...client import AuthenticatedClient, Client
from ...models.problem import Problem
from ...models.scanner_drift import ScannerDrift
from ...types import Response


def _get_kwargs(
    scanner_id: str,
) -> dict[str, Any]:

    _kwargs: dict[str, Any] = {
        "method": "get",
        "url": "/v1/scanners/{scanner_id}/drift".format(
            scanner_id=quote(str(scanner_id), safe=""),
        ),
    }

    return _kwargs


def _parse_response(*, client: AuthenticatedClient | Client, response: httpx.Response) -> Problem | ScannerDrift | None:
    if response.status_code == 200:
        response_200 = ScannerDrift.from_dict(response.json())

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

    if response.status_code == 404:
        response_404 = Problem.from_dict(response.json())

        return response_404

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
) -> Response[Problem | ScannerDrift]:
    return Response(
        status_code=HTTPStatus(response.status_code),
        content=response.content,
        headers=response.headers,
        parsed=_parse_response(client=client, response=response),
    )


def sync_detailed(
    scanner_id: str,
    *,
    client: AuthenticatedClient,
) -> Response[Problem | ScannerDrift]:
    """Get what a scanner's drift checks show together

     Since its active calibration: the baseline, the newest checks pooled, and whether it jumped or
    drifts slowly.

    Args:
        scanner_id (str): Lower-case letters, digits and hyphens.

    Raises:
        errors.UnexpectedStatus: If the server returns an undocumented status code and Client.raise_on_unexpected_status is True.
        httpx.TimeoutException: If the request takes longer than Client.timeout.

    Returns:
        Response[Problem | ScannerDrift]
    """

    kwargs = _get_kwargs(
        scanner_id=scanner_id,
    )

    response = client.get_httpx_client().request(
        **kwargs,
    )

    return _build_response(client=client, response=response)


def sync(
    scanner_id: str,
    *,
    client: AuthenticatedClient,
) -> Problem | ScannerDrift | None:
    """Get what a scanner's drift checks show together

     Since its active calibration: the baseline, the newest checks pooled, and whether it jumped or
    drifts slowly.

    Args:
        scanner_id (str): Lower-case letters, digits and hyphens.

    Raises:
        errors.UnexpectedStatus: If the server returns an undocumented status code and Client.raise_on_unexpected_status is True.
        httpx.TimeoutException: If the request takes longer than Client.timeout.

    Returns:
        Problem | ScannerDrift
    """

    return sync_detailed(
        scanner_id=scanner_id,
        client=client,
    ).parsed


async def asyncio_detailed(
    scanner_id: str,
    *,
    client: AuthenticatedClient,
) -> Response[Problem | ScannerDrift]:
    """Get what a scanner's drift checks show together

     Since its active calibration: the baseline, the newest checks pooled, and whether it jumped or
    drifts slowly.

    Args:
        scanner_id (str): Lower-case letters, digits and hyphens.

    Raises:
        errors.UnexpectedStatus: If the server returns an undocumented status code and Client.raise_on_unexpected_status is True.
        httpx.TimeoutException: If the request takes longer than Client.timeout.

    Returns:
        Response[Problem | ScannerDrift]
    """

    kwargs = _get_kwargs(
        scanner_id=scanner_id,
    )

    response = await client.get_async_httpx_client().request(**kwargs)

    return _build_response(client=client, response=response)


async def asyncio(
    scanner_id: str,
    *,
    client: AuthenticatedClient,
) -> Problem | ScannerDrift | None:
    """Get what a scanner's drift checks show together

     Since its active calibration: the baseline, the newest checks pooled, and whether it jumped or
    drifts slowly.

    Args:
        scanner_id (str): Lower-case letters, digits and hyphens.

    Raises:
        errors.UnexpectedStatus: If the server returns an undocumented status code and Client.raise_on_unexpected_status is True.
        httpx.TimeoutException: If the request takes longer than Client.timeout.

    Returns:
        Problem | ScannerDrift
    """

    return (
        await asyncio_detailed(
            scanner_id=scanner_id,
            client=client,
        )
    ).parsed
