"""Queries: unknown and repeated fields are refused, as in bodies; FastAPI would ignore them."""

import reprlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from difflib import get_close_matches
from typing import Any, get_args, get_origin

from fastapi import Request
from fastapi.dependencies.models import Dependant
from fastapi.exceptions import RequestValidationError
from fastapi.routing import APIRoute
from pydantic import BaseModel

from sawmill_service.http.problems import STATED, ProblemPlace


async def check_query(request: Request) -> None:
    """Refuse fields that the route does not know, and repeated fields that take one value; a dependency of every route.

    Pages are exempt, except those that read a model: an old bookmark still works.
    """
    route: APIRoute = request.scope["route"]
    query = request.query_params
    if not query or not route.include_in_schema:
        return
    types = dict(_fields(route.dependant))
    errors = []
    for name in query:
        values = query.getlist(name)
        if name not in types:
            errors.append(_refused((ProblemPlace.QUERY, name), values, f"is not a known field{near_name(name, types)}"))
        elif len(values) > 1 and not _is_list(types[name]):
            errors.append(repeated((ProblemPlace.QUERY, name), values))
    if errors:
        raise RequestValidationError(errors)


def _fields(dependant: Dependant) -> Iterator[tuple[str, object]]:
    """Yield the names and types of a route's query fields, including the fields of models and of dependencies."""
    for field in dependant.query_params:
        model = field.field_info.annotation
        if isinstance(model, type) and issubclass(model, BaseModel):
            yield from ((part.alias or name, part.annotation) for name, part in model.model_fields.items())
        else:
            yield field.alias, model
    for dependency in dependant.dependencies:
        yield from _fields(dependency)


def _is_list(annotation: object) -> bool:
    return get_origin(annotation) is list or any(map(_is_list, get_args(annotation)))


def near_name(name: str, names: Iterable[str]) -> str:
    """Return the end of a sentence about an unknown name: a similar known name; empty if there is none."""
    near = get_close_matches(name, sorted(names), n=1)
    return f": {near[0]!r} is" if near else ""


def repeated(place: Sequence[int | str], values: list[Any]) -> Mapping[str, object]:
    """Make the error of a repeated field that takes one value; its place begins with a part of the request."""
    return _refused(place, values, f"takes one value, not {len(values)}: {reprlib.repr(values)}")


def _refused(place: Sequence[int | str], values: list[Any], sentence: str) -> Mapping[str, object]:
    return {"type": STATED, "loc": tuple(place), "msg": sentence, "input": values}
