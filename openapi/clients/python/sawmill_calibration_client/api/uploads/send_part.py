from http import HTTPStatus
from typing import Any
from urllib.parse import quote

import httpx

from ... import errors
from ...client import AuthenticatedClient, Client
from ...models.problem import Problem
from ...models.upload import Upload
from ...types import UNSET, File, Response, Unset


def _get_kwargs(
    upload_id: str,
    *,
    body: File | Unset = UNSET,
    upload_offset: int,
    upload_complete: str | Unset = UNSET,
    upload_length: int | Unset = UNSET,
) -> dict[str, Any]:
    headers: dict[str, Any] = {}
    headers["Upload-Offset"] = str(upload_offset)

    if not isinstance(upload_complete, Unset):
        headers["Upload-Complete"] = upload_complete

    if not isinstance(upload_length, Unset):
        headers["Upload-Length"] = str(upload_length)

    _kwargs: dict[str, Any] = {
        "method": "patch",
        "url": "/v1/uploads/{upload_id}".format(
            upload_id=quote(str(upload_id), safe=""),
        ),
    }

    if not isinstance(body, Unset):
        _kwargs["content"] = body.payload
    headers["Content-Type"] = "application/octet-stream"

    _kwargs["headers"] = headers
    return _kwargs


def _parse_response(*, client: AuthenticatedClient | Client, response: httpx.Response) -> Problem | Upload | None:
    if response.status_code == 200:
        response_200 = Upload.from_dict(response.json())

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


def _build_response(*, client: AuthenticatedClient | Client, response: httpx.Response) -> Response[Problem | Upload]:
    return Response(
        status_code=HTTPStatus(response.status_code),
        content=response.content,
        headers=response.headers,
        parsed=_parse_response(client=client, response=response),
    )


def sync_detailed(
    upload_id: str,
    *,
    client: AuthenticatedClient,
    body: File | Unset = UNSET,
    upload_offset: int,
    upload_complete: str | Unset = UNSET,
    upload_length: int | Unset = UNSET,
) -> Response[Problem | Upload]:
    """Send a part of an upload

     The body is the file's bytes from the offset on, all that are missing or fewer.

    What came before a connection broke is kept, unless the part has a `Content-Digest`: then it counts
    as a whole.

    Args:
        upload_id (str): Lower-case letters, digits and hyphens.
        upload_offset (int):
        upload_complete (str | Unset):
        upload_length (int | Unset):
        body (File | Unset):

    Raises:
        errors.UnexpectedStatus: If the server returns an undocumented status code and Client.raise_on_unexpected_status is True.
        httpx.TimeoutException: If the request takes longer than Client.timeout.

    Returns:
        Response[Problem | Upload]
    """

    kwargs = _get_kwargs(
        upload_id=upload_id,
        body=body,
        upload_offset=upload_offset,
        upload_complete=upload_complete,
        upload_length=upload_length,
    )

    response = client.get_httpx_client().request(
        **kwargs,
    )

    return _build_response(client=client, response=response)


def sync(
    upload_id: str,
    *,
    client: AuthenticatedClient,
    body: File | Unset = UNSET,
    upload_offset: int,
    upload_complete: str | Unset = UNSET,
    upload_length: int | Unset = UNSET,
) -> Problem | Upload | None:
    """Send a part of an upload

     The body is the file's bytes from the offset on, all that are missing or fewer.

    What came before a connection broke is kept, unless the part has a `Content-Digest`: then it counts
    as a whole.

    Args:
        upload_id (str): Lower-case letters, digits and hyphens.
        upload_offset (int):
        upload_complete (str | Unset):
        upload_length (int | Unset):
        body (File | Unset):

    Raises:
        errors.UnexpectedStatus: If the server returns an undocumented status code and Client.raise_on_unexpected_status is True.
        httpx.TimeoutException: If the request takes longer than Client.timeout.

    Returns:
        Problem | Upload
    """

    return sync_detailed(
        upload_id=upload_id,
        client=client,
        body=body,
        upload_offset=upload_offset,
        upload_complete=upload_complete,
        upload_length=upload_length,
    ).parsed


async def asyncio_detailed(
    upload_id: str,
    *,
    client: AuthenticatedClient,
    body: File | Unset = UNSET,
    upload_offset: int,
    upload_complete: str | Unset = UNSET,
    upload_length: int | Unset = UNSET,
) -> Response[Problem | Upload]:
    """Send a part of an upload

     The body is the file's bytes from the offset on, all that are missing or fewer.

    What came before a connection broke is kept, unless the part has a `Content-Digest`: then it counts
    as a whole.

    Args:
        upload_id (str): Lower-case letters, digits and hyphens.
        upload_offset (int):
        upload_complete (str | Unset):
        upload_length (int | Unset):
        body (File | Unset):

    Raises:
        errors.UnexpectedStatus: If the server returns an undocumented status code and Client.raise_on_unexpected_status is True.
        httpx.TimeoutException: If the request takes longer than Client.timeout.

    Returns:
        Response[Problem | Upload]
    """

    kwargs = _get_kwargs(
        upload_id=upload_id,
        body=body,
        upload_offset=upload_offset,
        upload_complete=upload_complete,
        upload_length=upload_length,
    )

    response = await client.get_async_httpx_client().request(**kwargs)

    return _build_response(client=client, response=response)


async def asyncio(
    upload_id: str,
    *,
    client: AuthenticatedClient,
    body: File | Unset = UNSET,
    upload_offset: int,
    upload_complete: str | Unset = UNSET,
    upload_length: int | Unset = UNSET,
) -> Problem | Upload | None:
    """Send a part of an upload

     The body is the file's bytes from the offset on, all that are missing or fewer.

    What came before a connection broke is kept, unless the part has a `Content-Digest`: then it counts
    as a whole.

    Args:
        upload_id (str): Lower-case letters, digits and hyphens.
        upload_offset (int):
        upload_complete (str | Unset):
        upload_length (int | Unset):
        body (File | Unset):

    Raises:
        errors.UnexpectedStatus: If the server returns an undocumented status code and Client.raise_on_unexpected_status is True.
        httpx.TimeoutException: If the request takes longer than Client.timeout.

    Returns:
        Problem | Upload
    """

    return (
        await asyncio_detailed(
            upload_id=upload_id,
            client=client,
            body=body,
            upload_offset=upload_offset,
            upload_complete=upload_complete,
            upload_length=upload_length,
        )
    ).parsed
