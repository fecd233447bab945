"""The id under which a request is found again: in its answer, in its problem, and in every line of the log about it."""

import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any
from uuid import uuid4

from starlette.datastructures import Headers, MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from structlog.contextvars import bound_contextvars, clear_contextvars

HEADER = "X-Request-Id"
# What a proxy or a client may give: nothing that ends a header or a line of the log, or fills either.
_SAFE = re.compile(r"[A-Za-z0-9][A-Za-z0-9._:-]{0,63}")


class RequestIds:
    """Give each request an id, its client's where that is safe, and put it on the answer with those of key and job.

    Until the request is answered `structlog.contextvars` has it as `request_id`, in the threads that work on it too,
    and so has `scope["state"]`.
    """

    def __init__(self, app: ASGIApp) -> None:
        self.app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer one request."""
        if scope["type"] != "http":
            await self.app(scope, receive, send)
            return
        with named_request(_given(Headers(scope=scope))) as request_id:
            scope.setdefault("state", {})["request_id"] = request_id

            async def send_named(message: Message) -> None:
                if message["type"] == "http.response.start":
                    MutableHeaders(scope=message).update({HEADER: request_id, **_others(scope["state"])})
                await send(message)

            await self.app(scope, receive, send_named)


@contextmanager
def named_request(given: str | None = None) -> Iterator[str]:
    """Within the block all lines of the log, and problems, have this id, or a new one."""
    request_id = given or uuid4().hex
    # A request that came on the heels of another one is begun in that one's context.
    clear_contextvars()
    with bound_contextvars(request_id=request_id):
        yield request_id


def _others(state: Mapping[str, Any]) -> dict[str, str]:
    """The key that came with the request and the job that it queued, where there are such."""
    known = {"X-Key-Id": getattr(state.get("caller"), "key_id", None), "X-Job-Id": state.get("job_id")}
    return {name: value for name, value in known.items() if value is not None}


def _given(headers: Headers) -> str | None:
    given = headers.get(HEADER)
    return given if given is not None and _SAFE.fullmatch(given) else None
