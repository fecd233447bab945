from http import HTTPStatus
from typing import Any, cast
from urllib.parse import quote

import httpx

from ... import errors
from ...client import AuthenticatedClient, Client
from ...models.problem import Problem
from ...types import UNSET, Response, Unset


def _get_kwargs(
    job_id: str,
    *,
    last_event_id: int | Unset = UNSET,
) -> dict[str, Any]:
    headers: dict[str, Any] = {}
    if not isinstance(last_event_id, Unset):
        headers["Last-Event-ID"] = str(last_event_id)

    _kwargs: dict[str, Any] = {
        "method": "get",
        "url": "/v1/jobs/{job_id}/events".format(
            job_id=quote(str(job_id), safe=""),
        ),
    }

    _kwargs["headers"] = headers
    return _kwargs


def _parse_response(*, client: AuthenticatedClient | Client, response: httpx.Response) -> Any | Problem | None:
    if response.status_code == 200:
        response_200 = cast(Any, response.text)
        return response_200

    if response.status_code == 204:
        response_204 = cast(Any, None)
        return response_204

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


def _build_response(*, client: AuthenticatedClient | Client, response: httpx.Response) -> Response[Any | Problem]:
    return Response(
        status_code=HTTPStatus(response.status_code),
        content=response.content,
        headers=response.headers,
        parsed=_parse_response(client=client, response=response),
    )


def sync_detailed(
    job_id: str,
    *,
    client: AuthenticatedClient,
    last_event_id: int | Unset = UNSET,
) -> Response[Any | Problem]:
    """Stream a job's progress

     The job now and at each change; after the event `end` the client closes the stream.

    After any `Last-Event-ID` but that of `end` the stream begins with the job as it is.
    When the service stops, the last event is `closing`: the client connects again, after the time in
    `retry`. Ids are
    numbers that are stored, so they hold beyond a stream and a service.

    Args:
        job_id (str): Lower-case letters, digits and hyphens.
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
        job_id=job_id,
        last_event_id=last_event_id,
    )

    response = client.get_httpx_client().request(
        **kwargs,
    )

    return _build_response(client=client, response=response)


def sync(
    job_id: str,
    *,
    client: AuthenticatedClient,
    last_event_id: int | Unset = UNSET,
) -> Any | Problem | None:
    """Stream a job's progress

     The job now and at each change; after the event `end` the client closes the stream.

    After any `Last-Event-ID` but that of `end` the stream begins with the job as it is.
    When the service stops, the last event is `closing`: the client connects again, after the time in
    `retry`. Ids are
    numbers that are stored, so they hold beyond a stream and a service.

    Args:
        job_id (str): Lower-case letters, digits and hyphens.
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
        job_id=job_id,
        client=client,
        last_event_id=last_event_id,
    ).parsed


async def asyncio_detailed(
    job_id: str,
    *,
    client: AuthenticatedClient,
    last_event_id: int | Unset = UNSET,
) -> Response[Any | Problem]:
    """Stream a job's progress

     The job now and at each change; after the event `end` the client closes the stream.

    After any `Last-Event-ID` but that of `end` the stream begins with the job as it is.
    When the service stops, the last event is `closing`: the client connects again, after the time in
    `retry`. Ids are
    numbers that are stored, so they hold beyond a stream and a service.

    Args:
        job_id (str): Lower-case letters, digits and hyphens.
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
        job_id=job_id,
        last_event_id=last_event_id,
    )

    response = await client.get_async_httpx_client().request(**kwargs)

    return _build_response(client=client, response=response)


async def asyncio(
    job_id: str,
    *,
    client: AuthenticatedClient,
    last_event_id: int | Unset = UNSET,
) -> Any | Problem | None:
    """Stream a job's progress

     The job now and at each change; after the event `end` the client closes the stream.

    After any `Last-Event-ID` but that of `end` the stream begins with the job as it is.
    When the service stops, the last event is `closing`: the client connects again, after the time in
    `retry`. Ids are
    numbers that are stored, so they hold beyond a stream and a service.

    Args:
        job_id (str): Lower-case letters, digits and hyphens.
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
            job_id=job_id,
            client=client,
            last_event_id=last_event_id,
        )
    ).parsed
