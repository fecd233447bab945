"""Problems as pages for people: each kind's page, JSON for programs, and errors in words where a browser waits."""

import json
from http import HTTPStatus
from typing import Annotated, Any

from fastapi import Path, Request, Response
from fastapi.responses import RedirectResponse
from starlette.datastructures import Headers, MutableHeaders
from starlette.types import Message, Receive, Scope, Send

from sawmill_service.http.document.described_answers import refuses
from sawmill_service.http.middleware import Middleware
from sawmill_service.http.problem_types import CODE_PATTERN, PATH, ProblemType, ProblemTypes, problem_types
from sawmill_service.http.problems import MEDIA_TYPE, Refused, is_navigation
from sawmill_service.http.route_rules import NoKey, Router
from sawmill_service.pages.frame.languages import marked
from sawmill_service.pages.frame.page_frame import PageFrame, ThePage

router = Router(tags=["operation"])
_VARY = {"Vary": "Accept, Cookie"}


@router.get(PATH, needs=NoKey.AFTER_REFUSAL, summary="List the kinds of problems", response_model=ProblemTypes)
def list_problem_types(request: Request, page: ThePage, response: Response) -> Response | ProblemTypes:
    """List by code what each kind means, when it occurs and what to do. A browser gets a page, without internet too."""
    if is_navigation(request.headers):
        return page.answer("problem_types.html", headers=_VARY, kinds=problem_types().values())
    response.headers.update(_VARY)
    return ProblemTypes(items=list(problem_types().values()))


@router.get(PATH.rstrip("/"), needs=NoKey.AFTER_REFUSAL, include_in_schema=False)
def lead_to_list() -> RedirectResponse:
    """Lead to the list of the kinds of problems."""
    return RedirectResponse(PATH, 308)


@router.get(
    f"{PATH}{{code}}",
    needs=NoKey.AFTER_REFUSAL,
    summary="Get a kind of problem",
    response_model=ProblemType,
    responses=refuses("unknown-path"),
)
def get_problem_type(
    code: Annotated[
        str,
        Path(
            description="A problem's or a failure's `code`.",
            pattern=CODE_PATTERN,
            max_length=64,
            examples=["scanner-not-found"],
        ),
    ],
    request: Request,
    page: ThePage,
    response: Response,
) -> Response | ProblemType:
    """Explain what a `code` means, when it occurs and what to do. Problems' `type` and failed jobs link here."""
    kind = problem_types().get(code)
    if kind is None:
        raise Refused(404, "unknown-path", f"there is no problem {code!r}; {PATH} lists all that this version knows")
    if is_navigation(request.headers):
        return page.answer("problem_type.html", headers=_VARY, kind=kind)
    response.headers.update(_VARY)
    return kind


# Titles, advice, and whether to offer another attempt, by status.
_KNOWN = {
    401: (marked("Please log in"), marked("Log in with a key that this service knows."), False),
    403: (
        marked("You may not do this here"),
        marked("Load the page again. If that does not help, ask the person who gave you the key for another one."),
        False,
    ),
    404: (
        marked("There is nothing here"),
        marked("It may have been deleted, or the address is not quite right."),
        False,
    ),
    409: (
        marked("This cannot be done now"),
        marked("Something else stands in the way: look at it first, then do this again."),
        False,
    ),
    413: (marked("This is too large"), marked("Send a smaller file, or ask for the limit to be raised."), False),
    422: (
        marked("Something was not right"),
        marked("Go back, change what the sentence names, and send it again."),
        False,
    ),
    429: (marked("Too much at once"), marked("Wait a minute, then try again."), True),
    503: (
        marked("The service cannot answer now"),
        marked("It is starting, stopping, or its database is away. Try again in a few seconds."),
        True,
    ),
    507: (
        marked("The disk is full"),
        marked("Nothing was lost, nothing half-written stays. The person who runs the service must make room."),
        True,
    ),
}
_OURS = (
    marked("Something went wrong inside the service"),
    marked("This is no fault of yours. Try again; if it stays, tell the person who looks after the service."),
    True,
)
_OTHER = (marked("This did not work"), marked("Go back, and try it in another way."), False)


class ProblemPages(Middleware):
    """Middleware that turns a problem into a page where a browser waits for one."""

    async def _answer(self, scope: Scope, receive: Receive, send: Send) -> None:
        if not is_navigation(Headers(scope=scope)):
            await self.app(scope, receive, send)
            return
        await self.app(scope, receive, _Rewriter(scope, send))


class _Rewriter:
    """Sender that forwards messages, but sends a problem as a page."""

    def __init__(self, scope: Scope, send: Send) -> None:
        self._scope, self._send = scope, send
        self._start: Message | None = None
        self._body = b""

    async def __call__(self, message: Message) -> None:
        starts = message["type"] == "http.response.start"
        if starts and Headers(raw=message["headers"]).get("content-type") == MEDIA_TYPE:
            self._start = message
        elif self._start is None:
            await self._send(message)
        elif message["type"] == "http.response.body":
            self._body += message.get("body", b"")
            if not message.get("more_body", False):
                await self._send_page(self._start)

    async def _send_page(self, start: Message) -> None:
        html = problem_page(self._scope, json.loads(self._body)).encode()
        headers = MutableHeaders(raw=list(start["headers"]))
        headers["Content-Type"], headers["Content-Length"] = "text/html; charset=utf-8", str(len(html))
        headers["Cache-Control"] = "no-store"
        await self._send({**start, "headers": headers.raw})
        await self._send({"type": "http.response.body", "body": html})


def problem_page(scope: Scope, problem: dict[str, Any]) -> str:
    """Render a problem (RFC 9457) as a page: what happened, the sentence, what to do."""
    page, status = PageFrame(Request(scope)), int(problem["status"])
    ours = status >= HTTPStatus.INTERNAL_SERVER_ERROR
    title, advice, again = _KNOWN.get(status, _OURS if ours else _OTHER)
    return page.render(
        "problem.html",
        problem={"errors": None, "request_id": None, **problem},
        known=status != HTTPStatus.UNPROCESSABLE_ENTITY,
        title=page.text.gettext(title),
        advice=page.text.gettext(advice),
        again=again and scope["method"] == "GET",
        tone="bad" if ours else "watch",
    )
