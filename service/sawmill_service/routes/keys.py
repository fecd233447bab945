"""/v1/keys."""

from typing import Annotated

from fastapi import Query, Response
from pydantic import Field

from sawmill_platform.contracts.base import Contract, Identifier, Name, Page
from sawmill_platform.contracts.keys import Key, KeyRequest, KeyRotation, NewKey, Scope
from sawmill_service.dependencies import TheCaller, TheStore
from sawmill_service.http.bodies.sent_json import Sent
from sawmill_service.http.document.described_answers import refuses
from sawmill_service.http.document.openapi_document import trying
from sawmill_service.http.repeats import repeatable
from sawmill_service.http.responses.answers import Paging
from sawmill_service.http.route_rules import Router

router = Router(prefix="/v1/keys", tags=["keys"], reading=Scope.READ)

AT_ONCE = KeyRotation()


class CurrentKey(Contract):
    """Key of the request."""

    name: Name = Field(description="Name of the key.", examples=["scanner software of line 2"])
    scope: Scope = Field(description="Scope of the key.", examples=["submit"])
    key_id: Identifier | None = Field(
        description="Id of the key. Null: no key was needed, or it is the service's own token.",
        examples=["0f8b4c6d0d8a4b0e"],
    )


@router.get("/current", summary="Get the key that you use")
def get_current_key(caller: TheCaller) -> CurrentKey:
    """Return name and scope; `key_id` is null where a request needs no key, or with the service's own token."""
    return CurrentKey(name=caller.name, scope=caller.scope, key_id=caller.key_id)


@router.post(
    "",
    needs=Scope.ADMIN,
    status_code=201,
    summary="Make a key",
    openapi_extra=trying(body={"name": "scanner software of line 2", "scope": "submit"}),
    responses=refuses("key-expired", "secret-not-repeated"),
)
@repeatable
def create_key(ask: Sent[KeyRequest], store: TheStore, response: Response) -> NewKey:
    """Make a key. Its secret is in this answer and nowhere else."""
    response.headers["Cache-Control"] = "no-store"
    return store.keys.create(ask)


@router.get("", needs=Scope.ADMIN, summary="List keys, newest first", responses=refuses("invalid-cursor"))
def list_keys(paging: Annotated[Paging, Query()], store: TheStore) -> Page[Key]:
    """List keys without their secrets; with who made them and when they were last used."""
    return store.keys.page(after=paging.after, limit=paging.limit)


@router.post(
    "/{key_id}/rotate",
    needs=Scope.ADMIN,
    summary="Replace a key's secret",
    openapi_extra=trying(body={"grace_s": 3600}),
    responses=refuses("key-not-found", "key-ended", "secret-not-repeated"),
)
@repeatable
def rotate_key(
    key_id: Identifier, store: TheStore, response: Response, rotation: Sent[KeyRotation] = AT_ONCE
) -> NewKey:
    """Replace the secret, which is valid for the grace period. The new one is in this answer and nowhere else."""
    response.headers["Cache-Control"] = "no-store"
    return store.keys.rotate(key_id, grace_s=rotation.grace_s)


@router.delete("/{key_id}", needs=Scope.ADMIN, summary="Revoke a key", responses=refuses("key-not-found"))
def revoke_key(key_id: Identifier, store: TheStore) -> Key:
    """Revoke a key: it is refused from now on, and stays listed."""
    return store.keys.revoke(key_id)
