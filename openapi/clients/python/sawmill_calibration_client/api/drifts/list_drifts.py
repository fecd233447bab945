import datetime
from http import HTTPStatus
from typing import Any

import httpx

from ... import errors
from ...client import AuthenticatedClient, Client
from ...models.drift_page import DriftPage
from ...models.job_state import JobState
from ...models.problem import Problem
from ...types import UNSET, Response, Unset


def _get_kwargs(
    *,
    after: str | Unset = UNSET,
    limit: int | Unset = 50,
    created_from: datetime.datetime | Unset = UNSET,
    created_before: datetime.datetime | Unset = UNSET,
    scanner_id: str | Unset = UNSET,
    scan_id: str | Unset = UNSET,
    state: JobState | Unset = UNSET,
) -> dict[str, Any]:

    params: dict[str, Any] = {}

    params["after"] = after

    params["limit"] = limit

    json_created_from: str | Unset = UNSET
    if not isinstance(created_from, Unset):
        json_created_from = created_from.isoformat()
    params["created_from"] = json_created_from

    json_created_before: str | Unset = UNSET
    if not isinstance(created_before, Unset):
        json_created_before = created_before.isoformat()
    params["created_before"] = json_created_before

    params["scanner_id"] = scanner_id

    params["scan_id"] = scan_id

    json_state: str | Unset = UNSET
    if not isinstance(state, Unset):
        json_state = state.value

    params["state"] = json_state

    params = {k: v for k, v in params.items() if v is not UNSET and v is not None}

    _kwargs: dict[str, Any] = {
        "method": "get",
        "url": "/v1/drifts",
        "params": params,
    }

    return _kwargs


def _parse_response(*, client: AuthenticatedClient | Client, response: httpx.Response) -> DriftPage | Problem | None:
    if response.status_code == 200:
        response_200 = DriftPage.from_dict(response.json())

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


def _build_response(*, client: AuthenticatedClient | Client, response: httpx.Response) -> Response[DriftPage | Problem]:
    return Response(
        status_code=HTTPStatus(response.status_code),
        content=response.content,
        headers=response.headers,
        parsed=_parse_response(client=client, response=response),
    )


def sync_detailed(
    *,
    client: AuthenticatedClient,
    after: str | Unset = UNSET,
    limit: int | Unset = 50,
    created_from: datetime.datetime | Unset = UNSET,
    created_before: datetime.datetime | Unset = UNSET,
    scanner_id: str | Unset = UNSET,
    scan_id: str | Unset = UNSET,
    state: JobState | Unset = UNSET,
) -> Response[DriftPage | Problem]:
    """List drift checks, newest first

     All of them, or those of one scanner or scan, or in one state.

    Args:
        after (str | Unset): The `next` of the page before; nothing: the newest.
        limit (int | Unset): Items a page. Default: 50.
        created_from (datetime.datetime | Unset): The oldest moment, RFC 3339 with its offset.
        created_before (datetime.datetime | Unset): Only what is older than this moment, RFC 3339.
        scanner_id (str | Unset): Lower-case letters, digits and hyphens.
        scan_id (str | Unset): Lower-case letters, digits and hyphens.
        state (JobState | Unset): A job's life: queued, running, then one of the three ends.

    Raises:
        errors.UnexpectedStatus: If the server returns an undocumented status code and Client.raise_on_unexpected_status is True.
        httpx.TimeoutException: If the request takes longer than Client.timeout.

    Returns:
        Response[DriftPage | Problem]
    """

    kwargs = _get_kwargs(
        after=after,
        limit=limit,
        created_from=created_from,
        created_before=created_before,
        scanner_id=scanner_id,
        scan_id=scan_id,
        state=state,
    )

    response = client.get_httpx_client().request(
        **kwargs,
    )

    return _build_response(client=client, response=response)


def sync(
    *,
    client: AuthenticatedClient,
    after: str | Unset = UNSET,
    limit: int | Unset = 50,
    created_from: datetime.datetime | Unset = UNSET,
    created_before: datetime.datetime | Unset = UNSET,
    scanner_id: str | Unset = UNSET,
    scan_id: str | Unset = UNSET,
    state: JobState | Unset = UNSET,
) -> DriftPage | Problem | None:
    """List drift checks, newest first

     All of them, or those of one scanner or scan, or in one state.

    Args:
        after (str | Unset): The `next` of the page before; nothing: the newest.
        limit (int | Unset): Items a page. Default: 50.
        created_from (datetime.datetime | Unset): The oldest moment, RFC 3339 with its offset.
        created_before (datetime.datetime | Unset): Only what is older than this moment, RFC 3339.
        scanner_id (str | Unset): Lower-case letters, digits and hyphens.
        scan_id (str | Unset): Lower-case letters, digits and hyphens.
        state (JobState | Unset): A job's life: queued, running, then one of the three ends.

    Raises:
        errors.UnexpectedStatus: If the server returns an undocumented status code and Client.raise_on_unexpected_status is True.
        httpx.TimeoutException: If the request takes longer than Client.timeout.

    Returns:
        DriftPage | Problem
    """

    return sync_detailed(
        client=client,
        after=after,
        limit=limit,
        created_from=created_from,
        created_before=created_before,
        scanner_id=scanner_id,
        scan_id=scan_id,
        state=state,
    ).parsed


async def asyncio_detailed(
    *,
    client: AuthenticatedClient,
    after: str | Unset = UNSET,
    limit: int | Unset = 50,
    created_from: datetime.datetime | Unset = UNSET,
    created_before: datetime.datetime | Unset = UNSET,
    scanner_id: str | Unset = UNSET,
    scan_id: str | Unset = UNSET,
    state: JobState | Unset = UNSET,
) -> Response[DriftPage | Problem]:
    """List drift checks, newest first

     All of them, or those of one scanner or scan, or in one state.

    Args:
        after (str | Unset): The `next` of the page before; nothing: the newest.
        limit (int | Unset): Items a page. Default: 50.
        created_from (datetime.datetime | Unset): The oldest moment, RFC 3339 with its offset.
        created_before (datetime.datetime | Unset): Only what is older than this moment, RFC 3339.
        scanner_id (str | Unset): Lower-case letters, digits and hyphens.
        scan_id (str | Unset): Lower-case letters, digits and hyphens.
        state (JobState | Unset): A job's life: queued, running, then one of the three ends.

    Raises:
        errors.UnexpectedStatus: If the server returns an undocumented status code and Client.raise_on_unexpected_status is True.
        httpx.TimeoutException: If the request takes longer than Client.timeout.

    Returns:
        Response[DriftPage | Problem]
    """

    kwargs = _get_kwargs(
        after=after,
        limit=limit,
        created_from=created_from,
        created_before=created_before,
        scanner_id=scanner_id,
        scan_id=scan_id,
        state=state,
    )

    response = await client.get_async_httpx_client().request(**kwargs)

    return _build_response(client=client, response=response)


async def asyncio(
    *,
    client: AuthenticatedClient,
    after: str | Unset = UNSET,
    limit: int | Unset = 50,
    created_from: datetime.datetime | Unset = UNSET,
    created_before: datetime.datetime | Unset = UNSET,
    scanner_id: str | Unset = UNSET,
    scan_id: str | Unset = UNSET,
    state: JobState | Unset = UNSET,
) -> DriftPage | Problem | None:
    """List drift checks, newest first

     All of them, or those of one scanner or scan, or in one state.

    Args:
        after (str | Unset): The `next` of the page before; nothing: the newest.
        limit (int | Unset): Items a page. Default: 50.
        created_from (datetime.datetime | Unset): The oldest moment, RFC 3339 with its offset.
        created_before (datetime.datetime | Unset): Only what is older than this moment, RFC 3339.
        scanner_id (str | Unset): Lower-case letters, digits and hyphens.
        scan_id (str | Unset): Lower-case letters, digits and hyphens.
        state (JobState | Unset): A job's life: queued, running, then one of the three ends.

    Raises:
        errors.UnexpectedStatus: If the server returns an undocumented status code and Client.raise_on_unexpected_status is True.
        httpx.TimeoutException: If the request takes longer than Client.timeout.

    Returns:
        DriftPage | Problem
    """

    return (
        await asyncio_detailed(
            client=client,
            after=after,
            limit=limit,
            created_from=created_from,
            created_before=created_before,
            scanner_id=scanner_id,
            scan_id=scan_id,
            state=state,
        )
    ).parsed
