"""Kinds of problems: their list and a page of each for people, JSON for programs; no database is needed."""

from typing import Annotated

from fastapi import Path, Request, Response
from fastapi.responses import RedirectResponse

from sawmill_service.http.document.described_answers import refuses
from sawmill_service.http.problem_types import CODE_PATTERN, PATH, ProblemType, ProblemTypes, problem_types
from sawmill_service.http.problems import Refused, is_navigation
from sawmill_service.http.route_rules import NoKey, Router
from sawmill_service.pages.frame.page_frame import (
    ThePage,
)

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
