from http import HTTPStatus
from typing import Any

import httpx

from ... import errors
from ...client import AuthenticatedClient, Client
from ...models.alarm_list import AlarmList
from ...models.problem import Problem
from ...types import UNSET, Response, Unset


def _get_kwargs(
    *,
    scanner_id: str | Unset = UNSET,
) -> dict[str, Any]:

    params: dict[str, Any] = {}

    params["scanner_id"] = scanner_id

    params = {k: v for k, v in params.items() if v is not UNSET and v is not None}

    _kwargs: dict[str, Any] = {
        "method": "get",
        "url": "/v1/alarms",
        "params": params,
    }

    return _kwargs


def _parse_response(*, client: AuthenticatedClient | Client, response: httpx.Response) -> AlarmList | Problem | None:
    if response.status_code == 200:
        response_200 = AlarmList.from_dict(response.json())

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


def _build_response(*, client: AuthenticatedClient | Client, response: httpx.Response) -> Response[AlarmList | Problem]:
    return Response(
        status_code=HTTPStatus(response.status_code),
        content=response.content,
        headers=response.headers,
        parsed=_parse_response(client=client, response=response),
    )


def sync_detailed(
    *,
    client: AuthenticatedClient,
    scanner_id: str | Unset = UNSET,
) -> Response[AlarmList | Problem]:
    """List open alarms

     What should have come from a scanner by now and has not, and scanners that moved, as their logs
    together show.

    The limits are `alarms` of the scanner.

    Args:
        scanner_id (str | Unset): Those of this scanner. By default those of all.

    Raises:
        errors.UnexpectedStatus: If the server returns an undocumented status code and Client.raise_on_unexpected_status is True.
        httpx.TimeoutException: If the request takes longer than Client.timeout.

    Returns:
        Response[AlarmList | Problem]
    """

    kwargs = _get_kwargs(
        scanner_id=scanner_id,
    )

    response = client.get_httpx_client().request(
        **kwargs,
    )

    return _build_response(client=client, response=response)


def sync(
    *,
    client: AuthenticatedClient,
    scanner_id: str | Unset = UNSET,
) -> AlarmList | Problem | None:
    """List open alarms

     What should have come from a scanner by now and has not, and scanners that moved, as their logs
    together show.

    The limits are `alarms` of the scanner.

    Args:
        scanner_id (str | Unset): Those of this scanner. By default those of all.

    Raises:
        errors.UnexpectedStatus: If the server returns an undocumented status code and Client.raise_on_unexpected_status is True.
        httpx.TimeoutException: If the request takes longer than Client.timeout.

    Returns:
        AlarmList | Problem
    """

    return sync_detailed(
        client=client,
        scanner_id=scanner_id,
    ).parsed


async def asyncio_detailed(
    *,
    client: AuthenticatedClient,
    scanner_id: str | Unset = UNSET,
) -> Response[AlarmList | Problem]:
    """List open alarms

     What should have come from a scanner by now and has not, and scanners that moved, as their logs
    together show.

    The limits are `alarms` of the scanner.

    Args:
        scanner_id (str | Unset): Those of this scanner. By default those of all.

    Raises:
        errors.UnexpectedStatus: If the server returns an undocumented status code and Client.raise_on_unexpected_status is True.
        httpx.TimeoutException: If the request takes longer than Client.timeout.

    Returns:
        Response[AlarmList | Problem]
    """

    kwargs = _get_kwargs(
        scanner_id=scanner_id,
    )

    response = await client.get_async_httpx_client().request(**kwargs)

    return _build_response(client=client, response=response)


async def asyncio(
    *,
    client: AuthenticatedClient,
    scanner_id: str | Unset = UNSET,
) -> AlarmList | Problem | None:
    """List open alarms

     What should have come from a scanner by now and has not, and scanners that moved, as their logs
    together show.

    The limits are `alarms` of the scanner.

    Args:
        scanner_id (str | Unset): Those of this scanner. By default those of all.

    Raises:
        errors.UnexpectedStatus: If the server returns an undocumented status code and Client.raise_on_unexpected_status is True.
        httpx.TimeoutException: If the request takes longer than Client.timeout.

    Returns:
        AlarmList | Problem
    """

    return (
        await asyncio_detailed(
            client=client,
            scanner_id=scanner_id,
        )
    ).parsed
