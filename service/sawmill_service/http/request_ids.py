"""Id of a request: in its answer, in its problem, and in every line of the log about the request."""

import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any
from uuid import uuid4

from starlette.datastructures import Headers, MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from structlog.contextvars import bound_contextvars, clear_contextvars

HEADER = "X-Request-Id"
# Ids that a proxy or a client may give: they can neither end nor fill a header or a line of the log.
_SAFE = re.compile(r"[A-Za-z0-9][A-Za-z0-9._:-]{0,63}")


class RequestIds:
    """Middleware that gives each request an id, and puts the ids of request, key and job on the answer.

    The id is the client's if that is safe. Until the request is answered, `structlog.contextvars` has the id as
    `request_id`, also in the threads that handle the request, and so has `scope["state"]`.
    """

    def __init__(self, app: ASGIApp) -> None:
        self.app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer one request."""
        if scope["type"] != "http":
            await self.app(scope, receive, send)
            return
        with named_request(_client_id(Headers(scope=scope))) as request_id:
            scope.setdefault("state", {})["request_id"] = request_id

            async def send_named(message: Message) -> None:
                if message["type"] == "http.response.start":
                    MutableHeaders(scope=message).update({HEADER: request_id, **_key_and_job(scope["state"])})
                await send(message)

            await self.app(scope, receive, send_named)


@contextmanager
def named_request(client_id: str | None = None) -> Iterator[str]:
    """Give all lines of the log and problems within the block this id, or a new one."""
    request_id = client_id or uuid4().hex
    # A request that follows directly after another one starts in the context of that one.
    clear_contextvars()
    with bound_contextvars(request_id=request_id):
        yield request_id


def _key_and_job(state: Mapping[str, Any]) -> dict[str, str]:
    """Return the ids of the request's key and of the job that it queued, if there are any."""
    ids = {"X-Key-Id": getattr(state.get("caller"), "key_id", None), "X-Job-Id": state.get("job_id")}
    return {name: value for name, value in ids.items() if value is not None}


def _client_id(headers: Headers) -> str | None:
    client_id = headers.get(HEADER)
    return client_id if client_id is not None and _SAFE.fullmatch(client_id) else None
