"""Bodies of JSON: a field that stands in an object again is refused; Python's reader would take the last one."""

import json
from collections import Counter, deque
from collections.abc import Iterable, Mapping
from typing import Any

from fastapi import Request
from fastapi.concurrency import run_in_threadpool
from fastapi.exceptions import RequestValidationError
from fastapi.routing import APIRoute

from sawmill_service.problems import Place
from sawmill_service.queries import repeated

Pairs = list[tuple[str, Any]]


class _Repeating(dict[str, Any]):
    """An object in which a field stands again, with all that was sent of it."""

    def __init__(self, pairs: Pairs) -> None:
        super().__init__(pairs)
        self.pairs = pairs


async def check_body(request: Request) -> None:
    """Refuse a field that stands twice in an object; a dependency of every route.

    The body of a DELETE, which no route reads, is read where it has a digest: the gate checks that as it comes.

    Raises
    ------
    RequestValidationError
        With the outermost of them and its values: one is a fault of whatever wrote the body.
    """
    route: APIRoute = request.scope["route"]
    if route.body_field is None:
        if request.method == "DELETE" and "content-digest" in request.headers:
            await request.body()
        return
    try:
        # A thread is less deep than FastAPI was when it read this: what it could nest, the thread can.
        sent = await run_in_threadpool(_read, await request.body())
    except ValueError:  # it is not declared as JSON, else FastAPI would have refused it: the route does
        return
    if sent is not None:
        raise RequestValidationError([_first_repeated(sent)], body=sent)


def _read(body: bytes) -> Any:  # noqa: ANN401 - JSON
    """What was sent, where a field stands in it again; None: in no object."""
    found = False

    def made(pairs: Pairs) -> dict[str, Any]:
        nonlocal found
        fields = dict(pairs)
        if len(fields) == len(pairs):
            return fields
        found = True
        return _Repeating(pairs)

    sent = json.loads(body, object_pairs_hook=made)
    return sent if found else None


def _first_repeated(sent: object) -> Mapping[str, object]:
    # What to look at, each with its place, a chain: whole places of all would be large where they are deep.
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
    return repeated((Place.BODY, *names), [each for name, each in value.pairs if name == again])
