import datetime
from http import HTTPStatus
from typing import Any
from urllib.parse import quote

import httpx

from ... import errors
from ...client import AuthenticatedClient, Client
from ...models.history_entry_page import HistoryEntryPage
from ...models.history_kind import HistoryKind
from ...models.problem import Problem
from ...types import UNSET, Response, Unset


def _get_kwargs(
    scanner_id: str,
    *,
    after: str | Unset = UNSET,
    limit: int | Unset = 50,
    kind: HistoryKind | Unset = UNSET,
    since: datetime.datetime | Unset = UNSET,
    until: datetime.datetime | Unset = UNSET,
) -> dict[str, Any]:

    params: dict[str, Any] = {}

    params["after"] = after

    params["limit"] = limit

    json_kind: str | Unset = UNSET
    if not isinstance(kind, Unset):
        json_kind = kind.value

    params["kind"] = json_kind

    json_since: str | Unset = UNSET
    if not isinstance(since, Unset):
        json_since = since.isoformat()
    params["since"] = json_since

    json_until: str | Unset = UNSET
    if not isinstance(until, Unset):
        json_until = until.isoformat()
    params["until"] = json_until

    params = {k: v for k, v in params.items() if v is not UNSET and v is not None}

    _kwargs: dict[str, Any] = {
        "method": "get",
        "url": "/v1/scanners/{scanner_id}/history/entries".format(
            scanner_id=quote(str(scanner_id), safe=""),
        ),
        "params": params,
    }

    return _kwargs


def _parse_response(
    *, client: AuthenticatedClient | Client, response: httpx.Response
) -> HistoryEntryPage | Problem | None:
    if response.status_code == 200:
        response_200 = HistoryEntryPage.from_dict(response.json())

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
) -> Response[HistoryEntryPage | Problem]:
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
    after: str | Unset = UNSET,
    limit: int | Unset = 50,
    kind: HistoryKind | Unset = UNSET,
    since: datetime.datetime | Unset = UNSET,
    until: datetime.datetime | Unset = UNSET,
) -> Response[HistoryEntryPage | Problem]:
    """List what happened to a scanner, newest first

     Each calibration, drift check, activation, alarm and change of settings, with who, why and what it
    measured.

    Entries stay when what they are about is deleted.

    Args:
        scanner_id (str): Lower-case letters, digits and hyphens.
        after (str | Unset): The `next` of the page before; nothing: the newest.
        limit (int | Unset): Items a page. Default: 50.
        kind (HistoryKind | Unset): What an entry is about.
        since (datetime.datetime | Unset): Leave out entries before; RFC 3339.
        until (datetime.datetime | Unset): Leave out entries at this time and after; RFC 3339.

    Raises:
        errors.UnexpectedStatus: If the server returns an undocumented status code and Client.raise_on_unexpected_status is True.
        httpx.TimeoutException: If the request takes longer than Client.timeout.

    Returns:
        Response[HistoryEntryPage | Problem]
    """

    kwargs = _get_kwargs(
        scanner_id=scanner_id,
        after=after,
        limit=limit,
        kind=kind,
        since=since,
        until=until,
    )

    response = client.get_httpx_client().request(
        **kwargs,
    )

    return _build_response(client=client, response=response)


def sync(
    scanner_id: str,
    *,
    client: AuthenticatedClient,
    after: str | Unset = UNSET,
    limit: int | Unset = 50,
    kind: HistoryKind | Unset = UNSET,
    since: datetime.datetime | Unset = UNSET,
    until: datetime.datetime | Unset = UNSET,
) -> HistoryEntryPage | Problem | None:
    """List what happened to a scanner, newest first

     Each calibration, drift check, activation, alarm and change of settings, with who, why and what it
    measured.

    Entries stay when what they are about is deleted.

    Args:
        scanner_id (str): Lower-case letters, digits and hyphens.
        after (str | Unset): The `next` of the page before; nothing: the newest.
        limit (int | Unset): Items a page. Default: 50.
        kind (HistoryKind | Unset): What an entry is about.
        since (datetime.datetime | Unset): Leave out entries before; RFC 3339.
        until (datetime.datetime | Unset): Leave out entries at this time and after; RFC 3339.

    Raises:
        errors.UnexpectedStatus: If the server returns an undocumented status code and Client.raise_on_unexpected_status is True.
        httpx.TimeoutException: If the request takes longer than Client.timeout.

    Returns:
        HistoryEntryPage | Problem
    """

    return sync_detailed(
        scanner_id=scanner_id,
        client=client,
        after=after,
        limit=limit,
        kind=kind,
        since=since,
        until=until,
    ).parsed


async def asyncio_detailed(
    scanner_id: str,
    *,
    client: AuthenticatedClient,
    after: str | Unset = UNSET,
    limit: int | Unset = 50,
    kind: HistoryKind | Unset = UNSET,
    since: datetime.datetime | Unset = UNSET,
    until: datetime.datetime | Unset = UNSET,
) -> Response[HistoryEntryPage | Problem]:
    """List what happened to a scanner, newest first

     Each calibration, drift check, activation, alarm and change of settings, with who, why and what it
    measured.

    Entries stay when what they are about is deleted.

    Args:
        scanner_id (str): Lower-case letters, digits and hyphens.
        after (str | Unset): The `next` of the page before; nothing: the newest.
        limit (int | Unset): Items a page. Default: 50.
        kind (HistoryKind | Unset): What an entry is about.
        since (datetime.datetime | Unset): Leave out entries before; RFC 3339.
        until (datetime.datetime | Unset): Leave out entries at this time and after; RFC 3339.

    Raises:
        errors.UnexpectedStatus: If the server returns an undocumented status code and Client.raise_on_unexpected_status is True.
        httpx.TimeoutException: If the request takes longer than Client.timeout.

    Returns:
        Response[HistoryEntryPage | Problem]
    """

    kwargs = _get_kwargs(
        scanner_id=scanner_id,
        after=after,
        limit=limit,
        kind=kind,
        since=since,
        until=until,
    )

    response = await client.get_async_httpx_client().request(**kwargs)

    return _build_response(client=client, response=response)


async def asyncio(
    scanner_id: str,
    *,
    client: AuthenticatedClient,
    after: str | Unset = UNSET,
    limit: int | Unset = 50,
    kind: HistoryKind | Unset = UNSET,
    since: datetime.datetime | Unset = UNSET,
    until: datetime.datetime | Unset = UNSET,
) -> HistoryEntryPage | Problem | None:
    """List what happened to a scanner, newest first

     Each calibration, drift check, activation, alarm and change of settings, with who, why and what it
    measured.

    Entries stay when what they are about is deleted.

    Args:
        scanner_id (str): Lower-case letters, digits and hyphens.
        after (str | Unset): The `next` of the page before; nothing: the newest.
        limit (int | Unset): Items a page. Default: 50.
        kind (HistoryKind | Unset): What an entry is about.
        since (datetime.datetime | Unset): Leave out entries before; RFC 3339.
        until (datetime.datetime | Unset): Leave out entries at this time and after; RFC 3339.

    Raises:
        errors.UnexpectedStatus: If the server returns an undocumented status code and Client.raise_on_unexpected_status is True.
        httpx.TimeoutException: If the request takes longer than Client.timeout.

    Returns:
        HistoryEntryPage | Problem
    """

    return (
        await asyncio_detailed(
            scanner_id=scanner_id,
            client=client,
            after=after,
            limit=limit,
            kind=kind,
            since=since,
            until=until,
        )
    ).parsed
