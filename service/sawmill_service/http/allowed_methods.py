"""Which methods a path takes: a path without parameters is itself alone, though another's pattern fits it too."""

from collections.abc import Mapping

from fastapi import FastAPI, Request
from fastapi.routing import iter_route_contexts
from starlette.exceptions import HTTPException
from starlette.routing import compile_path
from starlette.types import Scope


def methods_by_pattern(app: FastAPI) -> Mapping[str, set[str]]:
    """The methods of each pattern of paths that the application has a route for."""
    found: dict[str, set[str]] = {}
    for route in iter_route_contexts(app.routes):
        found.setdefault(route.path or "", set()).update(route.methods or ())
    return found


def methods_of(scope: Scope) -> set[str]:
    """Those of a request's path; none where nothing is."""
    path, methods = scope["path"], scope["app"].methods_by_pattern
    fitting = [path] if path in methods else [each for each in methods if compile_path(each)[0].match(path)]
    return {method for pattern in fitting for method in methods[pattern]}


def allowed_methods(request: Request) -> str:
    """As `Allow` lists them, HEAD wherever GET is; empty where nothing is."""
    found = methods_of(request.scope)
    return ", ".join(sorted(found | ({"HEAD"} if "GET" in found else set())))


async def check_method(request: Request) -> None:
    """Refuse what a pattern would take for one of its ids; a dependency of every route.

    Raises
    ------
    HTTPException
        405, whose `Allow` the handler of problems adds.
    """
    if request.method not in request.app.methods_by_pattern.get(request.url.path, {request.method}):
        raise HTTPException(405)
