"""Bodies of JSON and queries: each value has its declared type, and no field is unknown or given twice.

FastAPI would take "1" and true for 1, and the last of two equal fields.
"""

import json
import reprlib
from collections import Counter, deque
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Annotated, Any, TypeVar, get_args, get_origin

from fastapi import Request
from fastapi.concurrency import run_in_threadpool
from fastapi.dependencies.models import Dependant
from fastapi.exceptions import RequestValidationError
from fastapi.routing import APIRoute
from pydantic import BaseModel, GetCoreSchemaHandler, TypeAdapter
from pydantic_core import CoreSchema, core_schema, from_json, to_json

from sawmill_platform.contracts.base import BYTE_ORDER_MARK, near_name, read_strictly
from sawmill_platform.contracts.given import hidden_characters
from sawmill_service.http.problems import STATED, ProblemPlace

Pairs = list[tuple[str, Any]]


class _Repeating(dict[str, Any]):
    """An object in which a field is repeated, with all pairs that were sent."""

    def __init__(self, pairs: Pairs) -> None:
        super().__init__(pairs)
        self.pairs = pairs


async def check_body(request: Request) -> None:
    """Refuse objects with a repeated field, and texts that cannot be displayed; a dependency of every route.

    The body of a DELETE, which no route reads, is read if it has a digest, which the gate checks as the body arrives.
    """
    route: APIRoute = request.scope["route"]
    if route.body_field is None:
        if request.method == "DELETE" and "content-digest" in request.headers:
            await request.body()
        return
    # FastAPI has read the body already, from a deeper stack: the thread can read the same nesting.
    await run_in_threadpool(_check, await request.body())


def _check(body: bytes) -> None:
    try:
        repeating = _read(body)
    except ValueError:  # not declared as JSON, else FastAPI would have refused the body: the route refuses it
        return
    if repeating is not None:
        raise RequestValidationError([_first_repeated(repeating)], body=repeating)
    try:
        sent = from_json(body.removeprefix(BYTE_ORDER_MARK))
    except ValueError as error:  # half a surrogate, or hundreds of lists in lists
        unread = {"type": STATED, "loc": (ProblemPlace.BODY,), "msg": f"cannot be read: {error}", "input": None}
        raise RequestValidationError([unread]) from error
    faults = hidden_characters(sent) if isinstance(sent, dict | list) else ()
    if hidden := [fault | {"loc": (ProblemPlace.BODY, *fault["loc"])} for fault in faults]:
        raise RequestValidationError(hidden, body=sent)


class Strictly:
    """Annotation by which pydantic reads a body as strict JSON: "1" and true are not 1, and a time is a text."""

    def __get_pydantic_core_schema__(self, contract: Any, handler: GetCoreSchemaHandler) -> CoreSchema:  # noqa: ANN401
        """Wrap the contract's schema, which takes the value that was read as it is."""
        strict = TypeAdapter(contract)

        def read(body: object) -> object:
            if isinstance(body, bytes):  # the media type is not JSON: the contract refuses the body
                return body
            return read_strictly(strict, to_json(body, inf_nan_mode="constants"))

        return core_schema.no_info_before_validator_function(read, handler(contract))


Body = TypeVar("Body")
# The type of a route's parameter that is its body.
Sent = Annotated[Body, Strictly()]


def _read(body: bytes) -> Any:  # noqa: ANN401 - JSON
    """Read a body in which an object has a field twice; return None for any other body."""
    has_repeated = False

    def made(pairs: Pairs) -> dict[str, Any]:
        nonlocal has_repeated
        fields = dict(pairs)
        if len(fields) == len(pairs):
            return fields
        has_repeated = True
        return _Repeating(pairs)

    sent = json.loads(body, object_pairs_hook=made)
    return sent if has_repeated else None


def _first_repeated(sent: object) -> Mapping[str, object]:
    # Values still to be inspected, each with its place as a chain: full places would be large for deep values.
    ahead: deque[tuple[tuple[Any, ...], Any]] = deque([((), sent)])
    while not isinstance((value := ahead[0][1]), _Repeating):
        place, _ = ahead.popleft()
        inner: Iterable[tuple[Any, Any]] = ()
        if isinstance(value, dict | list):
            inner = value.items() if isinstance(value, dict) else enumerate(value)
        ahead.extend(((place, name), each) for name, each in inner)
    [(again, _)] = Counter(name for name, _ in value.pairs).most_common(1)
    names, place = deque[int | str]([again]), ahead[0][0]
    while place:
        place, name = place
        names.appendleft(name)
    return repeated((ProblemPlace.BODY, *names), [each for name, each in value.pairs if name == again])


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
            errors.append(unknown((name,), values, types))
        elif len(values) > 1 and not _is_list(types[name]):
            errors.append(repeated((ProblemPlace.QUERY, name), values))
    if errors:
        raise RequestValidationError(errors)


def unknown(place: Sequence[str], values: list[Any], names: Iterable[str]) -> Mapping[str, object]:
    """Make the error of a name, the last of its place in the query, that is none of the known ones."""
    return _refused((ProblemPlace.QUERY, *place), values, f"is not a known field{near_name(place[-1], names)}")


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


def repeated(place: Sequence[int | str], values: list[Any]) -> Mapping[str, object]:
    """Make the error of a repeated field that takes one value; its place begins with a part of the request."""
    return _refused(place, values, f"takes one value, not {len(values)}: {reprlib.repr(values)}")


def _refused(place: Sequence[int | str], values: list[Any], sentence: str) -> Mapping[str, object]:
    return {"type": STATED, "loc": tuple(place), "msg": sentence, "input": values}
