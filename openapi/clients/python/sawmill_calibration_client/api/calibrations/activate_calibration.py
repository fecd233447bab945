from http import HTTPStatus
from typing import Any
from urllib.parse import quote

import httpx

from ... import errors
from ...client import AuthenticatedClient, Client
from ...models.activate import Activate
from ...models.problem import Problem
from ...models.stored_scanner import StoredScanner
from ...types import UNSET, Response, Unset


def _get_kwargs(
    calibration_id: str,
    *,
    body: Activate | Unset = UNSET,
    idempotency_key: str | Unset = UNSET,
) -> dict[str, Any]:
    headers: dict[str, Any] = {}
    if not isinstance(idempotency_key, Unset):
        headers["Idempotency-Key"] = idempotency_key

    _kwargs: dict[str, Any] = {
        "method": "post",
        "url": "/v1/calibrations/{calibration_id}/activate".format(
            calibration_id=quote(str(calibration_id), safe=""),
        ),
    }

    if not isinstance(body, Unset):
        _kwargs["json"] = body.to_dict()

    headers["Content-Type"] = "application/json"

    _kwargs["headers"] = headers
    return _kwargs


def _parse_response(
    *, client: AuthenticatedClient | Client, response: httpx.Response
) -> Problem | StoredScanner | None:
    if response.status_code == 200:
        response_200 = StoredScanner.from_dict(response.json())

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
) -> Response[Problem | StoredScanner]:
    return Response(
        status_code=HTTPStatus(response.status_code),
        content=response.content,
        headers=response.headers,
        parsed=_parse_response(client=client, response=response),
    )


def sync_detailed(
    calibration_id: str,
    *,
    client: AuthenticatedClient,
    body: Activate | Unset = UNSET,
    idempotency_key: str | Unset = UNSET,
) -> Response[Problem | StoredScanner]:
    """Make a calibration the active one

     Reconstructions use it from now on. An older one rolls back. Refused (409) without an answer.

    Args:
        calibration_id (str): Lower-case letters, digits and hyphens.
        idempotency_key (str | Unset): The client's own name for this request, as a UUID, in
            quotes or without: the same request with the same name makes nothing again within 48
            hours, and gets the first one's answer, with `Idempotency-Replayed: true`.
        body (Activate | Unset): Why a calibration becomes the active one.

    Raises:
        errors.UnexpectedStatus: If the server returns an undocumented status code and Client.raise_on_unexpected_status is True.
        httpx.TimeoutException: If the request takes longer than Client.timeout.

    Returns:
        Response[Problem | StoredScanner]
    """

    kwargs = _get_kwargs(
        calibration_id=calibration_id,
        body=body,
        idempotency_key=idempotency_key,
    )

    response = client.get_httpx_client().request(
        **kwargs,
    )

    return _build_response(client=client, response=response)


def sync(
    calibration_id: str,
    *,
    client: AuthenticatedClient,
    body: Activate | Unset = UNSET,
    idempotency_key: str | Unset = UNSET,
) -> Problem | StoredScanner | None:
    """Make a calibration the active one

     Reconstructions use it from now on. An older one rolls back. Refused (409) without an answer.

    Args:
        calibration_id (str): Lower-case letters, digits and hyphens.
        idempotency_key (str | Unset): The client's own name for this request, as a UUID, in
            quotes or without: the same request with the same name makes nothing again within 48
            hours, and gets the first one's answer, with `Idempotency-Replayed: true`.
        body (Activate | Unset): Why a calibration becomes the active one.

    Raises:
        errors.UnexpectedStatus: If the server returns an undocumented status code and Client.raise_on_unexpected_status is True.
        httpx.TimeoutException: If the request takes longer than Client.timeout.

    Returns:
        Problem | StoredScanner
    """

    return sync_detailed(
        calibration_id=calibration_id,
        client=client,
        body=body,
        idempotency_key=idempotency_key,
    ).parsed


async def asyncio_detailed(
    calibration_id: str,
    *,
    client: AuthenticatedClient,
    body: Activate | Unset = UNSET,
    idempotency_key: str | Unset = UNSET,
) -> Response[Problem | StoredScanner]:
    """Make a calibration the active one

     Reconstructions use it from now on. An older one rolls back. Refused (409) without an answer.

    Args:
        calibration_id (str): Lower-case letters, digits and hyphens.
        idempotency_key (str | Unset): The client's own name for this request, as a UUID, in
            quotes or without: the same request with the same name makes nothing again within 48
            hours, and gets the first one's answer, with `Idempotency-Replayed: true`.
        body (Activate | Unset): Why a calibration becomes the active one.

    Raises:
        errors.UnexpectedStatus: If the server returns an undocumented status code and Client.raise_on_unexpected_status is True.
        httpx.TimeoutException: If the request takes longer than Client.timeout.

    Returns:
        Response[Problem | StoredScanner]
    """

    kwargs = _get_kwargs(
        calibration_id=calibration_id,
        body=body,
        idempotency_key=idempotency_key,
    )

    response = await client.get_async_httpx_client().request(**kwargs)

    return _build_response(client=client, response=response)


async def asyncio(
    calibration_id: str,
    *,
    client: AuthenticatedClient,
    body: Activate | Unset = UNSET,
    idempotency_key: str | Unset = UNSET,
) -> Problem | StoredScanner | None:
    """Make a calibration the active one

     Reconstructions use it from now on. An older one rolls back. Refused (409) without an answer.

    Args:
        calibration_id (str): Lower-case letters, digits and hyphens.
        idempotency_key (str | Unset): The client's own name for this request, as a UUID, in
            quotes or without: the same request with the same name makes nothing again within 48
            hours, and gets the first one's answer, with `Idempotency-Replayed: true`.
        body (Activate | Unset): Why a calibration becomes the active one.

    Raises:
        errors.UnexpectedStatus: If the server returns an undocumented status code and Client.raise_on_unexpected_status is True.
        httpx.TimeoutException: If the request takes longer than Client.timeout.

    Returns:
        Problem | StoredScanner
    """

    return (
        await asyncio_detailed(
            calibration_id=calibration_id,
            client=client,
            body=body,
            idempotency_key=idempotency_key,
        )
    ).parsed
