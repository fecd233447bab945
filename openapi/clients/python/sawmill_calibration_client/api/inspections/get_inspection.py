from http import HTTPStatus
from typing import Any
from urllib.parse import quote

import httpx

from ... import errors
from ...client import AuthenticatedClient, Client
from ...models.inspection import Inspection
from ...models.problem import Problem
from ...types import UNSET, Response, Unset


def _get_kwargs(
    inspection_id: str,
    *,
    wait: float | Unset = 0.0,
) -> dict[str, Any]:

    params: dict[str, Any] = {}

    params["wait"] = wait

    params = {k: v for k, v in params.items() if v is not UNSET and v is not None}

    _kwargs: dict[str, Any] = {
        "method": "get",
        "url": "/v1/inspections/{inspection_id}".format(
            inspection_id=quote(str(inspection_id), safe=""),
        ),
        "params": params,
    }

    return _kwargs


def _parse_response(*, client: AuthenticatedClient | Client, response: httpx.Response) -> Inspection | Problem | None:
    if response.status_code == 200:
        response_200 = Inspection.from_dict(response.json())

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
) -> Response[Inspection | Problem]:
    return Response(
        status_code=HTTPStatus(response.status_code),
        content=response.content,
        headers=response.headers,
        parsed=_parse_response(client=client, response=response),
    )


def sync_detailed(
    inspection_id: str,
    *,
    client: AuthenticatedClient,
    wait: float | Unset = 0.0,
) -> Response[Inspection | Problem]:
    """Get an inspection

     Its state, and what was found once it has succeeded.

    Args:
        inspection_id (str): Lower-case letters, digits and hyphens.
        wait (float | Unset): Seconds to wait for the end of the job, 55 at most: the answer comes
            when it has ended, or as it is when the time is over. 0 does not wait. Default: 0.0.

    Raises:
        errors.UnexpectedStatus: If the server returns an undocumented status code and Client.raise_on_unexpected_status is True.
        httpx.TimeoutException: If the request takes longer than Client.timeout.

    Returns:
        Response[Inspection | Problem]
    """

    kwargs = _get_kwargs(
        inspection_id=inspection_id,
        wait=wait,
    )

    response = client.get_httpx_client().request(
        **kwargs,
    )

    return _build_response(client=client, response=response)


def sync(
    inspection_id: str,
    *,
    client: AuthenticatedClient,
    wait: float | Unset = 0.0,
) -> Inspection | Problem | None:
    """Get an inspection

     Its state, and what was found once it has succeeded.

    Args:
        inspection_id (str): Lower-case letters, digits and hyphens.
        wait (float | Unset): Seconds to wait for the end of the job, 55 at most: the answer comes
            when it has ended, or as it is when the time is over. 0 does not wait. Default: 0.0.

    Raises:
        errors.UnexpectedStatus: If the server returns an undocumented status code and Client.raise_on_unexpected_status is True.
        httpx.TimeoutException: If the request takes longer than Client.timeout.

    Returns:
        Inspection | Problem
    """

    return sync_detailed(
        inspection_id=inspection_id,
        client=client,
        wait=wait,
    ).parsed


async def asyncio_detailed(
    inspection_id: str,
    *,
    client: AuthenticatedClient,
    wait: float | Unset = 0.0,
) -> Response[Inspection | Problem]:
    """Get an inspection

     Its state, and what was found once it has succeeded.

    Args:
        inspection_id (str): Lower-case letters, digits and hyphens.
        wait (float | Unset): Seconds to wait for the end of the job, 55 at most: the answer comes
            when it has ended, or as it is when the time is over. 0 does not wait. Default: 0.0.

    Raises:
        errors.UnexpectedStatus: If the server returns an undocumented status code and Client.raise_on_unexpected_status is True.
        httpx.TimeoutException: If the request takes longer than Client.timeout.

    Returns:
        Response[Inspection | Problem]
    """

    kwargs = _get_kwargs(
        inspection_id=inspection_id,
        wait=wait,
    )

    response = await client.get_async_httpx_client().request(**kwargs)

    return _build_response(client=client, response=response)


async def asyncio(
    inspection_id: str,
    *,
    client: AuthenticatedClient,
    wait: float | Unset = 0.0,
) -> Inspection | Problem | None:
    """Get an inspection

     Its state, and what was found once it has succeeded.

    Args:
        inspection_id (str): Lower-case letters, digits and hyphens.
        wait (float | Unset): Seconds to wait for the end of the job, 55 at most: the answer comes
            when it has ended, or as it is when the time is over. 0 does not wait. Default: 0.0.

    Raises:
        errors.UnexpectedStatus: If the server returns an undocumented status code and Client.raise_on_unexpected_status is True.
        httpx.TimeoutException: If the request takes longer than Client.timeout.

    Returns:
        Inspection | Problem
    """

    return (
        await asyncio_detailed(
            inspection_id=inspection_id,
            client=client,
            wait=wait,
        )
    ).parsed
