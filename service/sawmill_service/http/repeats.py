"""`Idempotency-Key`: a repeated request creates nothing again, and gets the answer of the first request.

The IETF's draft-ietf-httpapi-idempotency-key-header-07 defines the header. docs/look-up/http.md has what the draft
leaves open.
"""

import hashlib
import inspect
import json
import re
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from dataclasses import dataclass, replace
from functools import partial, wraps
from typing import Annotated, Any, TypeVar, cast

from fastapi import Depends, FastAPI, Header, Request, Response
from fastapi.concurrency import run_in_threadpool
from starlette.exceptions import HTTPException

from sawmill_platform.contracts.base import Contract
from sawmill_platform.errors import StorageError
from sawmill_platform.files.upload_stream import Received
from sawmill_platform.keys.repeats import KeptAnswer, KeyedRequest, Repeats
from sawmill_service.access import caller_of
from sawmill_service.dependencies import TheStore
from sawmill_service.http.problems import Refused
from sawmill_service.uploads import body_begun, body_sha256, check_no_file
from sawmill_store.mill_files import MillFiles

HEADER, REPLAYED = "Idempotency-Key", "Idempotency-Replayed"
SECRET = "secret"  # noqa: S105 - the name of a field
# A string of RFC 9651 (section 3.3.3), or a text without quotes, which some clients send.
_QUOTED = re.compile(r'"((?:[ !#-\[\]-~]|\\["\\]){1,200})"')
_BARE = re.compile(r"[!#-~]{1,200}")

Made = TypeVar("Made", bound=Contract)
Key = Annotated[
    str | None,
    Header(
        alias=HEADER,
        description="The client's own name for this request, as a UUID, in quotes or without: the same request with "
        f"the same name makes nothing again within 48 hours, and gets the first one's answer, with `{REPLAYED}: true`.",
        json_schema_extra={"pattern": f"^({_QUOTED.pattern}|{_BARE.pattern})$"},
    ),
]


class AnsweredBefore(Exception):  # noqa: N818 - no error
    """Raised for a repeat, with its answer."""

    def __init__(self, answer: KeptAnswer) -> None:
        super().__init__()
        self.answer = answer


@dataclass(frozen=True)
class Repeatable:
    """A request that may be repeated if it has an idempotency key."""

    # request, response: request, and the response whose headers the route sets.
    request: Request
    response: Response
    repeats: Repeats  # store that keeps the answers
    files: MillFiles  # data folder, which has the received file
    keyed: KeyedRequest | None  # request with its key; None: it has no key

    def once(self, make: Callable[[], Made], *, file_sha256: str | None = None) -> Made:
        """Create the resource, in one transaction with the answer for repeats."""
        if self.keyed is None:
            return make()
        made = self.repeats.once(replace(self.keyed, file_sha256=file_sha256), make, self._kept)
        if isinstance(made, KeptAnswer):
            raise _repeated(made, self.request)
        return made

    def once_with(self, received: Received, make: Callable[[], Made], *, in_body: bool) -> Made:
        """Call `once` with a received file, which is discarded unless `make` takes it.

        `in_body` is False if the file came before this request.
        """
        try:
            return self.once(make, file_sha256=received.sha256 if in_body else None)
        finally:
            self.files.discard(received)

    @asynccontextmanager
    async def unless_repeated(self) -> AsyncIterator[None]:
        """Answer a repeat before the block, which receives a file or looks up a file by name.

        The block may refuse the request because the first request was answered in the meantime. The request is a repeat
        then too, unless a part of the body has been read, so that no checksum can be computed any more.
        """
        await self.check_sent()
        try:
            yield
        except (HTTPException, StorageError):
            if not body_begun(self.request):
                await self.check_sent()
            raise

    async def check_sent(self) -> None:
        """Answer a repeat; its body is read for that: the file, or nothing if the request names an earlier file."""
        if self.keyed is None:
            return
        kept = await run_in_threadpool(self.repeats.find, self.keyed)
        if kept is None:
            return
        same, digest = kept.request.request_sha256 == self.keyed.request_sha256, None
        if same and kept.request.file_sha256 is None:
            await check_no_file(self.request)
        elif same:
            digest = await body_sha256(self.request, max_bytes=self.request.app.state.settings.max_upload_bytes)
        raise _repeated(kept.answer_to(replace(self.keyed, file_sha256=digest)), self.request)

    def _kept(self, made: Contract) -> KeptAnswer:
        return KeptAnswer(
            status=self.response.status_code or self.request.scope["route"].status_code or 200,
            headers=dict(self.response.headers),
            body=made.model_dump_json(by_alias=True, exclude={SECRET}),
            whole=SECRET not in type(made).model_fields,
        )


async def _repeatable(request: Request, response: Response, store: TheStore, key: Key = None) -> Repeatable:
    """Return the repeatable request of a route whose body is JSON or empty."""
    return Repeatable(request, response, store.repeats, store.files, _keyed(request, key, await request.body()))


async def _repeatable_with_file(request: Request, response: Response, store: TheStore, key: Key = None) -> Repeatable:
    """Return the repeatable request of a route whose body is a file."""
    return Repeatable(request, response, store.repeats, store.files, _keyed(request, key, b""))


def _keyed(request: Request, key: str | None, body: bytes) -> KeyedRequest | None:
    if key is None:
        return None
    caller, scope = caller_of(request), request.scope
    parts = (scope["method"].encode(), scope["path"].encode(), scope["query_string"], body)
    digest = hashlib.sha256(b"\0".join(parts)).hexdigest()
    return KeyedRequest(caller.name if caller.key_id is None else f"key {caller.key_id}", _read(key), digest)


def _read(key: str) -> str:
    if quoted := _QUOTED.fullmatch(key):
        return re.sub(r"\\(.)", r"\1", quoted[1])
    if _BARE.fullmatch(key):
        return key
    raise Refused(
        400,
        "bad-idempotency-key",
        f"{HEADER} must be 1 to 200 visible ASCII characters, in quotes or without, not {key[:100]!r}",
    )


TheRepeatable = Annotated[Repeatable, Depends(_repeatable)]
TheRepeatableWithFile = Annotated[Repeatable, Depends(_repeatable_with_file)]


def repeatable(endpoint: Callable[..., Made]) -> Callable[..., Made]:
    """Have a route whose body is JSON, or empty, take `Idempotency-Key`."""

    @wraps(endpoint)
    def once(repeatable: Repeatable, **arguments: Any) -> Made:  # noqa: ANN401 - the route's own
        return repeatable.once(partial(endpoint, **arguments))

    signature = inspect.signature(endpoint)
    added = inspect.Parameter("repeatable", inspect.Parameter.KEYWORD_ONLY, annotation=TheRepeatable)
    once.__signature__ = signature.replace(parameters=[*signature.parameters.values(), added])  # type: ignore[attr-defined]
    return once


def _repeated(answer: KeptAnswer, request: Request) -> AnsweredBefore | Refused:
    if answer.whole:
        return AnsweredBefore(answer)
    # Only keys and webhooks have secrets, and one path pattern replaces them.
    made, kinds = json.loads(answer.body)["id"], request.url.path.split("/")[2]
    what = f"{kinds.removesuffix('s')} {made!r}"
    return Refused(
        409,
        "secret-not-repeated",
        f"the first request with this {HEADER} was answered, and the secret of {what} stood in its answer alone: "
        f"POST /v1/{kinds}/{made}/rotate, with another {HEADER}, makes a new one",
    )


def _on_repeat(_request: Request, error: Exception) -> Response:
    answer = cast("AnsweredBefore", error).answer
    return Response(answer.body, answer.status, answer.headers | {REPLAYED: "true"}, media_type="application/json")


def install(app: FastAPI) -> None:
    """Install the handler that answers repeats."""
    app.add_exception_handler(AnsweredBefore, _on_repeat)
