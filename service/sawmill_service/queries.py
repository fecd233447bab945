"""Queries: what a route does not know is refused, as in bodies, and nothing of it is ignored."""

from collections.abc import Iterator
from difflib import get_close_matches

from fastapi import Request
from fastapi.dependencies.models import Dependant
from fastapi.exceptions import RequestValidationError
from fastapi.routing import APIRoute
from pydantic import BaseModel

from sawmill_service.problems import UNKNOWN_IN_QUERY


async def check_query(request: Request) -> None:
    """Refuse fields that the route does not know; a dependency of every route.

    Pages are left out, but for those that read a model of their own: an old bookmark still leads to one.

    Raises
    ------
    RequestValidationError
        With a near name that is known, where there is one.
    """
    route: APIRoute = request.scope["route"]
    if not request.query_params or not route.include_in_schema:
        return
    known = sorted(_fields(route.dependant))
    errors = [_unknown(name, value, known) for name, value in request.query_params.items() if name not in known]
    if errors:
        raise RequestValidationError(errors)


def _fields(dependant: Dependant) -> Iterator[str]:
    """Names of a route's query fields, those of models and of dependencies among them."""
    for field in dependant.query_params:
        model = field.field_info.annotation
        if isinstance(model, type) and issubclass(model, BaseModel):
            yield from (declared.alias or name for name, declared in model.model_fields.items())
        else:
            yield field.alias
    for dependency in dependant.dependencies:
        yield from _fields(dependency)


def _unknown(name: str, value: str, known: list[str]) -> dict[str, object]:
    near = get_close_matches(name, known, n=1)
    right = f": {near[0]!r} is" if near else ""
    return {"type": UNKNOWN_IN_QUERY, "loc": ("query", name), "msg": f"is not a known field{right}", "input": value}
