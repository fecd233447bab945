"""Common part of all pages: the language, the caller, and the templates with both."""

from functools import cache, partial
from typing import Annotated

from fastapi import Depends, Request
from fastapi.responses import HTMLResponse
from jinja2 import Environment

from sawmill_platform.contracts.keys import Scope
from sawmill_service.access import ANYBODY, Caller
from sawmill_service.http.problem_types import problem_types
from sawmill_service.http.session_cookie import SessionCookie
from sawmill_service.pages.frame.languages import (
    ENGLISH,
    LANGUAGES,
    Formats,
    locale_of,
    preferred_language,
    texts,
)
from sawmill_service.pages.frame.navigation import NAVIGATION
from sawmill_service.pages.frame.verdicts import shown_questions
from sawmill_vocabulary.messages import Reason
from sawmill_worker.templating import templates_of

LANGUAGE_COOKIE, THEME_COOKIE = "sawmill_language", "sawmill_theme"
THEMES = ("auto", "light", "dark")


class PageFrame:
    """Page that answers one request, in the browser's language."""

    def __init__(self, request: Request) -> None:
        self._request = request
        self.caller: Caller = getattr(request.state, "caller", ANYBODY)
        self.language = preferred_language(
            request.cookies.get(LANGUAGE_COOKIE, ""), request.headers.get("accept-language", "")
        )
        self.text = texts(self.language)
        self.formats = formats_of(self.language)

    def answer(
        self, template: str, *, status: int = 200, headers: dict[str, str] | None = None, **values: object
    ) -> HTMLResponse:
        """Answer with a page for its caller, which no cache keeps, so that nobody finds it after the logout."""
        html = self.render(template, **values)
        answer = HTMLResponse(html, status, {"Cache-Control": "no-store", "Vary": "Cookie", **(headers or {})})
        self._keep_display_open(answer)
        return answer

    def render(self, template: str, **values: object) -> str:
        """Return the text of a template, for a page or a part of one."""
        return (
            templates(self.language)
            .get_template(f"pages/{template}")
            .render(
                caller=self.caller,
                may=self.may,
                language=self.language,
                languages=LANGUAGES,
                theme=self._theme(),
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

    def _theme(self) -> str:
        chosen = self._request.cookies.get(THEME_COOKIE, "")
        return chosen if chosen in THEMES else THEMES[0]

    def _keep_display_open(self, answer: HTMLResponse) -> None:
        """Renew the cookie of a display with each page."""
        if self.caller.display and self.caller.csrf_token is not None:
            cookie: SessionCookie = self._request.app.state.session_cookie
            secret = cookie.read(self._request.scope, self._request.headers)
            cookie.give(answer, self._request.scope, secret, lasting=True)


ThePage = Annotated[PageFrame, Depends()]


@cache
def formats_of(language: str) -> Formats:
    """Return the formats of numbers and times in a language."""
    return Formats(locale_of(language), texts(language))


@cache
def templates(language: str = ENGLISH) -> Environment:
    """Return the templates in a language."""
    environment = templates_of("sawmill_service", ["jinja2.ext.i18n"])
    text, formats = texts(language), formats_of(language)
    environment.install_gettext_translations(text, newstyle=True)  # type: ignore[attr-defined]
    environment.filters |= formats.filters()
    environment.globals["failures"] = {code: kind for code, kind in problem_types().items() if kind.failure}
    environment.globals["verdict_questions"] = shown_questions(text, formats)
    environment.globals["in_words"] = partial(Reason.in_words, reader=formats.reader)
    return environment
