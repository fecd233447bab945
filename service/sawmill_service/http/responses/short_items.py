"""Short items of lists: those fields alone that `?fields=` names."""

import json
from collections.abc import Callable, Coroutine, Iterable
from typing import Any, get_args

from fastapi import Request, Response
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse
from pydantic import BaseModel

from sawmill_platform.contracts.base import Page
from sawmill_service.http.bodies.sent_json import unknown

Handler = Callable[[Request], Coroutine[Any, Any, Response]]


def is_page(model: object) -> bool:
    """Return whether a route answers a page of a list."""
    return isinstance(model, type) and issubclass(model, Page)


def with_short_items(page: Any, answer: Handler) -> Handler:  # noqa: ANN401 - a type of page
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


def _names(annotation: Any) -> Iterable[str]:  # noqa: ANN401 - a type
    """Yield the names of the fields of items, which may be of several types."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield from (field.alias or name for name, field in annotation.model_fields.items())
    for each in get_args(getattr(annotation, "__value__", annotation)):
        yield from _names(each)
