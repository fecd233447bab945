"""Routes of every kind of job that clients request: ask, list and get, as the declaration describes them."""

from collections.abc import Mapping
from typing import Annotated, Any

from fastapi import Depends, Path, Query, Response
from pydantic import Field, create_model

from sawmill_contracts.calibrations import CalibrationSucceeded
from sawmill_contracts.kinds import AskedKind, Operation, Reference
from sawmill_mill.next_step import step_alone
from sawmill_platform.contracts.base import Contract, Identifier, Page
from sawmill_platform.contracts.jobs import JobState, Priority
from sawmill_platform.contracts.keys import Scope
from sawmill_service.dependencies import TheCaller, TheSettings, TheStore, TheWake
from sawmill_service.http.bodies.sent_json import Strictly
from sawmill_service.http.document.described_answers import Responses, refuses, refuses_ask
from sawmill_service.http.document.old_names import announce, announced
from sawmill_service.http.document.openapi_document import trying
from sawmill_service.http.repeats import repeatable
from sawmill_service.http.responses.answers import Dated, RequestPriority, accept
from sawmill_service.http.responses.waiting import TheWaiting
from sawmill_service.http.route_rules import Router


def router_of(declared: AskedKind[Any, Any]) -> Router:
    """Return the router of a kind."""
    router = Router(tags=[declared.tag or declared.kind.plural], reading=Scope.READ)
    folder = f"/v1/{declared.kind.plural}"
    noun, plural = (name.replace("-", "_") for name in (declared.noun, declared.kind.plural))

    def ask(
        ask: Contract,
        path_ids: Annotated[Mapping[str, str], Depends(_ids_in_path(declared))],
        store: TheStore,
        settings: TheSettings,
        wake: TheWake,
        caller: TheCaller,
        response: Response,
        priority: Annotated[RequestPriority, Query()] = Priority.INTERACTIVE,
    ) -> Any:  # noqa: ANN401 - the kind's answer
        caller.check(declared.needed_scope(ask))
        answer = store.asked(declared).accept(ask, priority=priority, given=path_ids)
        wake(answer.job_id)
        accept(response, f"{folder}/{answer.id}", settings.retry_after_s)
        announce(ask, caller, response)
        return linked(declared, answer)

    def list_all(query: Dated, store: TheStore) -> Any:  # noqa: ANN401 - a page of answers
        page = store.asked(declared).page(**query.model_dump())
        return page.model_copy(update={"items": [linked(declared, item) for item in page.items]})

    async def get(
        identifier: Annotated[Identifier, Path(alias=declared.id_name)], store: TheStore, waiting: TheWaiting
    ) -> Any:  # noqa: ANN401 - the kind's answer
        return linked(declared, await waiting.read(lambda: store.asked(declared).get(identifier)))

    # Types of body and query for FastAPI, which are known only here.
    ask.__annotations__["ask"] = Annotated[declared.ask, Strictly()]
    list_all.__annotations__["query"] = Annotated[_filter(declared), Query()]
    one, many = declared.answer, Page.__class_getitem__(declared.answer)
    if declared.upload is None:
        asking = _described(f"create_{noun}", one, declared.to_ask, announced(declared.ask) | refuses_ask(declared))
        # By its declaration, an ask may need more: `ask` checks that.
        asking |= {"methods": ["POST"], "status_code": 202, "needs": Scope.SUBMIT}
        router.add_api_route(declared.asked_at or folder, repeatable(ask), **asking)
    router.add_api_route(
        folder, list_all, **_described(f"list_{plural}", many, declared.to_list, refuses("invalid-cursor"))
    )
    router.add_api_route(
        f"{folder}/{{{declared.id_name}}}",
        get,
        **_described(f"get_{noun}", one, declared.to_get, refuses(f"{declared.noun}-not-found")),
    )
    return router


def _described(
    name: str,
    response_model: Any,  # noqa: ANN401 - a type
    operation: Operation,
    responses: Responses,
) -> dict[str, Any]:
    return {
        "name": name,
        "response_model": response_model,
        "summary": operation.summary,
        "description": operation.description,
        "responses": responses,
        "openapi_extra": trying(**operation.example),
    }


def _filter(declared: AskedKind[Any, Any]) -> type[Dated]:
    fields: dict[str, Any] = {
        name: (JobState | None, None)
        if name == "state"
        else (Identifier | None, Field(None, description=f"Id of the {name.removesuffix('_id')}. Default: any."))
        for name in declared.listed_by
    }
    return create_model(f"{declared.noun}_filter", __base__=Dated, **fields)


def _ids_in_path(declared: AskedKind[Any, Any]) -> Any:  # noqa: ANN401 - a dependency
    """Return a dependency that reads the id of a reference from the path of the ask, if the path has one."""
    names = [f"{name}_id" for name in Reference if f"{{{name}_id}}" in (declared.asked_at or "")]

    def none() -> Mapping[str, str]:
        return {}

    def one(identifier: Annotated[Identifier, Path(alias=names[0] if names else None)]) -> Mapping[str, str]:
        return {names[0]: identifier}

    return one if names else none


def linked(declared: AskedKind[Any, Any], answer: Any) -> Any:  # noqa: ANN401 - the kind's answer
    """Return the answer with links to itself and its job, files and references; a calibration with its next step."""
    path = f"/v1/{declared.kind.plural}/{answer.id}"
    links = {"self": path, "job": f"/v1/jobs/{answer.job_id}"}
    links |= {name: f"{path}/{file}" for name, file in declared.files.items()}
    for name in declared.links.model_fields.keys() - links.keys():
        identifier = getattr(answer, f"{name}_id")
        links[name] = identifier and f"/v1/{name}s/{identifier}"
    update: dict[str, Contract] = {"links": declared.links.model_validate(links)}
    if isinstance(answer, CalibrationSucceeded):
        update["next_step"] = step_alone(answer).answer
    return answer.model_copy(update=update)
