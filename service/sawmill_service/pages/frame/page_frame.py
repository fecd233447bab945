"""Common part of all pages: the language and the colours of a browser, the caller, the header and the templates."""

import gettext
import re
from collections.abc import Mapping
from functools import cache, partial
from types import MappingProxyType
from typing import Annotated

from fastapi import Depends, Query, Request
from fastapi.responses import HTMLResponse, RedirectResponse
from jinja2 import Environment

from sawmill_calibration.pictures.templating import templates_of
from sawmill_platform.contracts.jobs import Failure
from sawmill_platform.contracts.keys import Scope
from sawmill_platform.errors import if_found
from sawmill_platform.jobs.job_store import Jobs
from sawmill_service.access import ANYBODY, Caller, SessionCookie
from sawmill_service.http.problem_types import problem_types
from sawmill_service.http.route_rules import NoKey, Router
from sawmill_service.pages.frame.languages import (
    ENGLISH,
    LANGUAGES,
    Formats,
    known_zone,
    locale_of,
    marked,
    preferred_language,
    texts,
)
from sawmill_service.pages.frame.stored_words import stored_words
from sawmill_service.pages.frame.verdicts import shown_questions
from sawmill_store.store import Store
from sawmill_vocabulary.messages import Reason

LANGUAGE_COOKIE, THEME_COOKIE = "sawmill_language", "sawmill_theme"
THEMES = ("auto", "light", "dark")


class PageFrame:
    """Page that answers one request, in the browser's language."""

    def __init__(self, request: Request, zone: str | None = None) -> None:
        self._request = request
        self.zone = zone  # time zone of the mill; None: nobody has set it, or the store is not asked
        self.caller: Caller = getattr(request.state, "caller", ANYBODY)
        self.language = preferred_language(
            request.cookies.get(LANGUAGE_COOKIE, ""), request.headers.get("accept-language", "")
        )
        self.text = texts(self.language)
        self.formats = formats_of(self.language, zone)

    def answer(
        self, template: str, *, status: int = 200, headers: dict[str, str] | None = None, **values: object
    ) -> HTMLResponse:
        """Answer with a page for its caller, which no cache keeps, so that nobody finds it after the logout."""
        html = self.render(template, **values)
        answer = HTMLResponse(html, status, {"Cache-Control": "no-store", "Vary": "Cookie", **(headers or {})})
        # The cookie of a display is renewed with each page.
        if self.caller.display and self.caller.csrf_token is not None:
            cookie: SessionCookie = self._request.app.state.session_cookie
            secret = cookie.read(self._request.scope, self._request.headers)
            cookie.give(answer, self._request.scope, secret, lasting=True)
        return answer

    def render(self, template: str, **values: object) -> str:
        """Return the text of a template, for a page or a part of one."""
        chosen = self._request.cookies.get(THEME_COOKIE, "")
        return (
            templates(self.language, self.zone)
            .get_template(f"pages/{template}")
            .render(
                caller=self.caller,
                may=self.may,
                failure_of=self._failure_of,
                language=self.language,
                languages=LANGUAGES,
                zone=self.zone,
                theme=chosen if chosen in THEMES else THEMES[0],
                themes=THEMES,
                navigation=() if self.caller is ANYBODY else NAVIGATION,
                here=self._request.url.path,
                here_with_query=str(self._request.url.replace(scheme="", netloc="")),
                **values,
            )
        )

    def may(self, scope: str) -> bool:
        """Return whether the caller may do what needs a scope, as `activate`."""
        return self.caller.scope.covers(Scope(scope))

    def _failure_of(self, job_id: str) -> Failure | None:
        """Return why a job failed; None where it did not, or its row was removed."""
        jobs: Jobs = self._request.app.state.store.jobs
        job = if_found(jobs.get, job_id)
        return None if job is None else job.failure


def _frame(request: Request) -> PageFrame:
    store: Store = request.app.state.store
    zone = store.mill_zone.get()
    return PageFrame(request, None if zone is None else known_zone(zone))


ThePage = Annotated[PageFrame, Depends(_frame)]


@cache
def formats_of(language: str, zone: str | None = None) -> Formats:
    """Return the formats of numbers and times in a language and a time zone; None: this machine's."""
    return Formats(locale_of(language), texts(language), zone)


@cache
def templates(language: str = ENGLISH, zone: str | None = None) -> Environment:
    """Return the templates in a language and a time zone."""
    environment = templates_of("sawmill_service", ["jinja2.ext.i18n"])
    text, formats = texts(language), formats_of(language, zone)
    environment.install_gettext_translations(text, newstyle=True)  # type: ignore[attr-defined]
    environment.filters |= formats.filters()
    environment.filters["stored"] = partial(_stored, text)
    environment.globals["failures"] = {code: kind for code, kind in problem_types().items() if kind.failure}
    environment.globals["verdict_questions"] = shown_questions(text, formats)
    environment.globals["in_words"] = partial(Reason.in_words, reader=formats.reader)
    return environment


def _stored(
    text: gettext.NullTranslations, stored: str | None, labels: Mapping[str, str] = MappingProxyType({})
) -> str:
    """Return a text of a row in the reader's language; empty without one."""
    return stored_words(stored, text.gettext, lambda name: labels.get(name, name)) if stored else ""


NAVIGATION = (
    ("/", marked("Today")),
    ("/calibrate", marked("Calibrate")),
    ("/logs", marked("Logs")),
    ("/scans", marked("Scans")),
    ("/phantoms", marked("Phantoms")),
    ("/jobs", marked("Jobs")),
    ("/system", marked("System")),
)


def local_path(path: str) -> str:
    r"""Return the path if it is one of this service, else Today's: `//` and `/\` may lead to another site."""
    return path if re.fullmatch(r"(?![^?]*//)/[!-\[\]-~]*", path) else "/"


LOOK = "/look"
YEAR_S = 365 * 86400

router = Router(include_in_schema=False)


@router.get(LOOK, needs=NoKey.LOGIN)
def look(
    request: Request,
    language: Annotated[str, Query()] = "",
    theme: Annotated[str, Query()] = "",
    onward: Annotated[str, Query(alias="next")] = "/",
) -> RedirectResponse:
    """Keep the language and the theme that are known, and return to the page."""
    answer = RedirectResponse(local_path(onward), status_code=303)
    for name, value, known in [(LANGUAGE_COOKIE, language, LANGUAGES), (THEME_COOKIE, theme, THEMES)]:
        if value in known:
            answer.set_cookie(name, value, max_age=YEAR_S, secure=request.url.scheme == "https", samesite="lax")
    return answer
