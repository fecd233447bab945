"""Rules of a route, declared in its decorator: who may use it, and how large its body may be; `?fields=` of lists."""
# ruff: noqa: ANN401 - options of FastAPI's decorators are passed on

import json
from collections.abc import Callable, Coroutine, Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Any, TypeVar, cast, get_args

from fastapi import APIRouter, Request, Response
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse
from fastapi.routing import APIRoute, iter_route_contexts
from pydantic import BaseModel
from starlette.exceptions import HTTPException
from starlette.routing import BaseRoute, compile_path
from starlette.types import Scope as RequestScope

from sawmill_platform.contracts.base import Page
from sawmill_platform.contracts.keys import Scope
from sawmill_service.http.bodies.sent_json import unknown
from sawmill_service.settings import ServiceSettings

Handler = Callable[[Request], Coroutine[Any, Any, Response]]


def with_short_items(page: Any, answer: Handler) -> Handler:
    """Return a handler of this type of page that leaves out the fields of items that the query does not name."""
    known = set(_names(page.model_fields["items"].annotation))

    async def shortened(request: Request) -> Response:
        response = await answer(request)
        names = request.query_params.get("fields", "").split(",")
        if names == [""]:
            return response
        if errors := [unknown(("fields", name), [name], known) for name in names if name not in known]:
            raise RequestValidationError(errors)
        whole = json.loads(bytes(response.body))
        items = [{name: item[name] for name in names if name in item} for item in whole["items"]]
        return JSONResponse(whole | {"items": items})

    return shortened


def _names(annotation: Any) -> Iterable[str]:
    """Yield the names of the fields of items, which may be of several types."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield from (field.alias or name for name, field in annotation.model_fields.items())
    for each in get_args(getattr(annotation, "__value__", annotation)):
        yield from _names(each)


Endpoint = TypeVar("Endpoint", bound=Callable[..., Any])
# A scanner's settings, with a token.
_FORM_BYTES = 8192


class NoKey(StrEnum):
    """Requests that a route answers without a key."""

    # All requests: the route reports the state of the service alone. Their rate is counted apart.
    MONITORING = "monitoring"
    LOGIN = "login"  # all requests: the route is the login, or the login page loads it
    AFTER_REFUSAL = "after refusal"  # requests whose key is missing or wrong: the route explains refusals


@dataclass(frozen=True)
class Rule:
    """Rule of a route."""

    needs: Scope | NoKey  # scope that a key needs, or the reason for which no key is needed
    # Bytes that a file in the body may have, from the settings; the route checks its digest, in a thread. None: the
    # body is no file, has at most `max_json_bytes`, and its digest is checked as it comes.
    max_body: Callable[[ServiceSettings], int] | None = None
    max_form_bytes: int = _FORM_BYTES  # bytes that a form of a page may have

    @property
    def scope(self) -> Scope:
        """Scope that a request needs, with a key or without."""
        return Scope.READ if isinstance(self.needs, NoKey) else self.needs


class Route(APIRoute):
    """A route with its rule; None: it declares no scope, and no application starts with it."""

    rule: Rule | None = None

    def get_route_handler(self) -> Handler:
        """Return the handler; a list's shortens its items to the fields of the query."""
        answer = super().get_route_handler()
        return (
            with_short_items(self.response_model, answer)
            if (isinstance(self.response_model, type) and issubclass(self.response_model, Page))
            else answer
        )


def _adding(method: str) -> Callable[..., Callable[[Endpoint], Endpoint]]:
    """Make the decorator of a router that adds routes of a method."""

    def at(router: "Router", path: str, **options: Any) -> Callable[[Endpoint], Endpoint]:
        def add(endpoint: Endpoint) -> Endpoint:
            router.add_api_route(path, endpoint, methods=[method], **options)
            return endpoint

        return add

    return at


class Router(APIRouter):
    """A router whose routes declare their rules: `@router.post("/scans", needs=Scope.SUBMIT)`."""

    def __init__(self, *, reading: Scope | None = None, **options: Any) -> None:
        super().__init__(route_class=Route, **options)
        self._reading = reading

    def add_api_route(
        self,
        path: str,
        endpoint: Callable[..., Any],
        *,
        needs: Scope | NoKey | None = None,
        max_body: Callable[[ServiceSettings], int] | None = None,
        max_form_bytes: int = _FORM_BYTES,
        **options: Any,
    ) -> None:
        """Add a route with its rule."""
        super().add_api_route(path, endpoint, **options)
        route = cast("Route", self.routes[-1])
        needs = needs or (self._reading if route.methods == {"GET"} else None)
        route.rule = None if needs is None else Rule(needs, max_body, max_form_bytes)

    get = _adding("GET")
    post = _adding("POST")
    put = _adding("PUT")
    patch = _adding("PATCH")
    delete = _adding("DELETE")


class RouteRules:
    """Rules of all routes of an application."""

    def __init__(self, routes: Sequence[BaseRoute]) -> None:
        self.by_pattern: dict[str, dict[str, Rule]] = {}
        for route in iter_route_contexts(routes):
            rules = self.by_pattern.setdefault(route.path or "", {})
            for method in route.methods or ():
                rule = getattr(route.original_route, "rule", None)
                if rule is None:
                    raise ValueError(f"{method} {route.path} declares no scope: give `needs` to its decorator")
                rules.setdefault(method, rule)
        self._patterns = [(compile_path(path)[0], rules) for path, rules in self.by_pattern.items() if "{" in path]

    def of_path(self, path: str) -> Mapping[str, Rule]:
        """Return the rule of each method that a path takes; none for a path that is no route's.

        A path without parameters takes its own methods only, although the pattern of another route fits too.
        """
        if path in self.by_pattern:
            return self.by_pattern[path]
        fitting = [rules for pattern, rules in self._patterns if pattern.match(path)]
        return {method: rule for rules in reversed(fitting) for method, rule in rules.items()}


def rules_of(scope: RequestScope) -> Mapping[str, Rule]:
    """Return the rule of each method that the path of a request takes, before the request has come to its route."""
    rules: RouteRules = scope["app"].state.rules
    return rules.of_path(scope["path"])


def no_key(scope: RequestScope) -> NoKey | None:
    """Return the reason for which the path of a request needs no key, whatever its method; None: a key is needed."""
    return next((rule.needs for rule in rules_of(scope).values() if isinstance(rule.needs, NoKey)), None)


def rule_of(request: Request) -> Rule:
    """Return the rule of the route that a request has come to."""
    rule: Rule = request.scope["route"].rule
    return rule


async def check_method(request: Request) -> None:
    """Refuse a path without parameters that a pattern would take for an id; a dependency of every route."""
    if request.method not in request.app.state.rules.by_pattern.get(request.url.path, {request.method}):
        raise HTTPException(405)
