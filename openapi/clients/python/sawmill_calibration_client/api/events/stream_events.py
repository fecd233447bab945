from http import HTTPStatus
from typing import Any, cast

import httpx

from ... import errors
from ...client import AuthenticatedClient, Client
from ...models.problem import Problem
from ...types import UNSET, Response, Unset


def _get_kwargs(
    *,
    scanner_id: str | Unset = UNSET,
    after: int | Unset = UNSET,
    duration_s: float | Unset = UNSET,
    last_event_id: int | Unset = UNSET,
) -> dict[str, Any]:
    headers: dict[str, Any] = {}
    if not isinstance(last_event_id, Unset):
        headers["Last-Event-ID"] = str(last_event_id)

    params: dict[str, Any] = {}

    params["scanner_id"] = scanner_id

    params["after"] = after

    params["duration_s"] = duration_s

    params = {k: v for k, v in params.items() if v is not UNSET and v is not None}

    _kwargs: dict[str, Any] = {
        "method": "get",
        "url": "/v1/events",
        "params": params,
    }

    _kwargs["headers"] = headers
    return _kwargs


def _parse_response(*, client: AuthenticatedClient | Client, response: httpx.Response) -> Any | Problem | None:
    if response.status_code == 200:
        response_200 = cast(Any, response.text)
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


def _build_response(*, client: AuthenticatedClient | Client, response: httpx.Response) -> Response[Any | Problem]:
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
    after: int | Unset = UNSET,
    duration_s: float | Unset = UNSET,
    last_event_id: int | Unset = UNSET,
) -> Response[Any | Problem]:
    """Follow what happens

     Whatever changes: jobs, what they work on, scanners, schedules, uploads and keys.

    What happened since `Last-Event-ID` comes first, nothing of it twice; without it comes what happens
    from now on.
    `alive` comes at once and then every five seconds in which nothing happened. While the database does
    not answer,
    comments come in its place, and the stream goes on afterwards. When the service stops, the key or
    `duration_s` has
    ended, the last event is `closing`: the client connects again, after the time in `retry`.

    Args:
        scanner_id (str | Unset): Those that concern this scanner; nothing: all.
        after (int | Unset): The number of the last event that the client has seen, for one that
            cannot send `Last-Event-ID`.
        duration_s (float | Unset): Seconds after which the stream ends; nothing: the service's
            life.
        last_event_id (int | Unset): The `id` of the last event that the client has seen, as
            browsers send it by themselves: the stream goes on from there. Without it, it begins with
            now.

    Raises:
        errors.UnexpectedStatus: If the server returns an undocumented status code and Client.raise_on_unexpected_status is True.
        httpx.TimeoutException: If the request takes longer than Client.timeout.

    Returns:
        Response[Any | Problem]
    """

    kwargs = _get_kwargs(
        scanner_id=scanner_id,
        after=after,
        duration_s=duration_s,
        last_event_id=last_event_id,
    )

    response = client.get_httpx_client().request(
        **kwargs,
    )

    return _build_response(client=client, response=response)


def sync(
    *,
    client: AuthenticatedClient,
    scanner_id: str | Unset = UNSET,
    after: int | Unset = UNSET,
    duration_s: float | Unset = UNSET,
    last_event_id: int | Unset = UNSET,
) -> Any | Problem | None:
    """Follow what happens

     Whatever changes: jobs, what they work on, scanners, schedules, uploads and keys.

    What happened since `Last-Event-ID` comes first, nothing of it twice; without it comes what happens
    from now on.
    `alive` comes at once and then every five seconds in which nothing happened. While the database does
    not answer,
    comments come in its place, and the stream goes on afterwards. When the service stops, the key or
    `duration_s` has
    ended, the last event is `closing`: the client connects again, after the time in `retry`.

    Args:
        scanner_id (str | Unset): Those that concern this scanner; nothing: all.
        after (int | Unset): The number of the last event that the client has seen, for one that
            cannot send `Last-Event-ID`.
        duration_s (float | Unset): Seconds after which the stream ends; nothing: the service's
            life.
        last_event_id (int | Unset): The `id` of the last event that the client has seen, as
            browsers send it by themselves: the stream goes on from there. Without it, it begins with
            now.

    Raises:
        errors.UnexpectedStatus: If the server returns an undocumented status code and Client.raise_on_unexpected_status is True.
        httpx.TimeoutException: If the request takes longer than Client.timeout.

    Returns:
        Any | Problem
    """

    return sync_detailed(
        client=client,
        scanner_id=scanner_id,
        after=after,
        duration_s=duration_s,
        last_event_id=last_event_id,
    ).parsed


async def asyncio_detailed(
    *,
    client: AuthenticatedClient,
    scanner_id: str | Unset = UNSET,
    after: int | Unset = UNSET,
    duration_s: float | Unset = UNSET,
    last_event_id: int | Unset = UNSET,
) -> Response[Any | Problem]:
    """Follow what happens

     Whatever changes: jobs, what they work on, scanners, schedules, uploads and keys.

    What happened since `Last-Event-ID` comes first, nothing of it twice; without it comes what happens
    from now on.
    `alive` comes at once and then every five seconds in which nothing happened. While the database does
    not answer,
    comments come in its place, and the stream goes on afterwards. When the service stops, the key or
    `duration_s` has
    ended, the last event is `closing`: the client connects again, after the time in `retry`.

    Args:
        scanner_id (str | Unset): Those that concern this scanner; nothing: all.
        after (int | Unset): The number of the last event that the client has seen, for one that
            cannot send `Last-Event-ID`.
        duration_s (float | Unset): Seconds after which the stream ends; nothing: the service's
            life.
        last_event_id (int | Unset): The `id` of the last event that the client has seen, as
            browsers send it by themselves: the stream goes on from there. Without it, it begins with
            now.

    Raises:
        errors.UnexpectedStatus: If the server returns an undocumented status code and Client.raise_on_unexpected_status is True.
        httpx.TimeoutException: If the request takes longer than Client.timeout.

    Returns:
        Response[Any | Problem]
    """

    kwargs = _get_kwargs(
        scanner_id=scanner_id,
        after=after,
        duration_s=duration_s,
        last_event_id=last_event_id,
    )

    response = await client.get_async_httpx_client().request(**kwargs)

    return _build_response(client=client, response=response)


async def asyncio(
    *,
    client: AuthenticatedClient,
    scanner_id: str | Unset = UNSET,
    after: int | Unset = UNSET,
    duration_s: float | Unset = UNSET,
    last_event_id: int | Unset = UNSET,
) -> Any | Problem | None:
    """Follow what happens

     Whatever changes: jobs, what they work on, scanners, schedules, uploads and keys.

    What happened since `Last-Event-ID` comes first, nothing of it twice; without it comes what happens
    from now on.
    `alive` comes at once and then every five seconds in which nothing happened. While the database does
    not answer,
    comments come in its place, and the stream goes on afterwards. When the service stops, the key or
    `duration_s` has
    ended, the last event is `closing`: the client connects again, after the time in `retry`.

    Args:
        scanner_id (str | Unset): Those that concern this scanner; nothing: all.
        after (int | Unset): The number of the last event that the client has seen, for one that
            cannot send `Last-Event-ID`.
        duration_s (float | Unset): Seconds after which the stream ends; nothing: the service's
            life.
        last_event_id (int | Unset): The `id` of the last event that the client has seen, as
            browsers send it by themselves: the stream goes on from there. Without it, it begins with
            now.

    Raises:
        errors.UnexpectedStatus: If the server returns an undocumented status code and Client.raise_on_unexpected_status is True.
        httpx.TimeoutException: If the request takes longer than Client.timeout.

    Returns:
        Any | Problem
    """

    return (
        await asyncio_detailed(
            client=client,
            scanner_id=scanner_id,
            after=after,
            duration_s=duration_s,
            last_event_id=last_event_id,
        )
    ).parsed
