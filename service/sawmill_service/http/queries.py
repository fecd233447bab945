"""Queries: what a route would pass over is refused, as in bodies: fields that it does not know, and repeated ones."""

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
    """Refuse fields that the route does not know, and those of one value that stand there twice.

    A dependency of every route. Pages are left out, but for those that read a model of their own: an old bookmark
    still leads to one.

    Raises
    ------
    RequestValidationError
        With a near name that is known, where there is one.
    """
    route: APIRoute = request.scope["route"]
    query = request.query_params
    if not query or not route.include_in_schema:
        return
    known = dict(_fields(route.dependant))
    errors = []
    for name in query:
        values = query.getlist(name)
        if name not in known:
            errors.append(_refused((ProblemPlace.QUERY, name), values, f"is not a known field{near_name(name, known)}"))
        elif len(values) > 1 and not _is_list(known[name]):
            errors.append(repeated((ProblemPlace.QUERY, name), values))
    if errors:
        raise RequestValidationError(errors)


def _fields(dependant: Dependant) -> Iterator[tuple[str, object]]:
    """Names and types of a route's query fields, those of models and of dependencies among them."""
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


def near_name(name: str, known: Iterable[str]) -> str:
    """A known name that is like an unknown one, as the end of a sentence about it; empty: none is."""
    near = get_close_matches(name, sorted(known), n=1)
    return f": {near[0]!r} is" if near else ""


def repeated(place: Sequence[int | str], values: list[Any]) -> Mapping[str, object]:
    """The refusal of a field of one value that stands there several times, its place beginning with a part."""
    return _refused(place, values, f"takes one value, not {len(values)}: {reprlib.repr(values)}")


def _refused(place: Sequence[int | str], values: list[Any], sentence: str) -> Mapping[str, object]:
    return {"type": STATED, "loc": tuple(place), "msg": sentence, "input": values}
