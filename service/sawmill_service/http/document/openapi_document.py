"""OpenAPI document: FastAPI's own, with every answer listed and an example for every operation."""

import json
from collections.abc import Iterable, Iterator, Mapping
from functools import cached_property
from http import HTTPStatus
from pathlib import Path
from typing import Any, NamedTuple

from fastapi import FastAPI

from sawmill_service.http.document.described_answers import BINARY, CODES_KEY, HEADERS, describe_answers, list_refusals
from sawmill_service.http.problems import Problem
from sawmill_service.http.route_rules import NoKey, RouteRules

TRY = "x-try"
SECURITY_SCHEMES = {
    "key": {"type": "http", "scheme": "bearer", "description": "A key; each operation states the scope that it needs."},
    "password": {"type": "http", "scheme": "basic", "description": "The same key as the password, with any user."},
}


def trying(**values: Any) -> dict[str, Any]:  # noqa: ANN401 - any JSON value
    """Give the values for the console's "Try it out": parameters by name, and the JSON `body`.

    A required parameter without a value takes the first example of the parameter's type.
    """
    return {TRY: values}


def trying_file(
    media_type: str,
    file: str,
    *,
    required: bool = True,
    **values: Any,  # noqa: ANN401 - any JSON value
) -> dict[str, Any]:
    """Give the values for an operation whose body is a file; `file` is the path of an example file of the service."""
    return {
        TRY: values,
        "x-example-file": file,
        "requestBody": {"required": required, "content": {media_type: {"schema": BINARY}}},
    }


class Application(FastAPI):
    """FastAPI with this service's OpenAPI document."""

    def openapi(self) -> dict[str, Any]:
        """Return the document, which is made once."""
        if self.openapi_schema is None:
            self.openapi_schema = _finish(super().openapi(), self.state.rules)
        return self.openapi_schema

    @cached_property
    def openapi_json(self) -> bytes:
        """Document as it is served, written once: writing takes longer than most requests."""
        return json.dumps(self.openapi(), separators=(",", ":"), ensure_ascii=False).encode()


def render(app: FastAPI) -> str:
    """Write the document as it is committed: sorted keys, two spaces, a newline at the end."""
    return json.dumps(app.openapi(), indent=2, sort_keys=True, ensure_ascii=False) + "\n"


class ExampleRequest(NamedTuple):
    """Request that works on a fresh data folder."""

    operation_id: str
    method: str
    path: str
    headers: dict[str, str]
    query: dict[str, Any]
    body: Any
    body_file: str | None
    media_type: str | None

    def render(self) -> str:
        """Write the request as it is committed."""
        return json.dumps(self._asdict(), indent=2, sort_keys=True, ensure_ascii=False) + "\n"


def write(app: FastAPI, folder: Path) -> None:
    """Write `openapi.json` and a file for each request in `requests/`; remove requests of operations that are gone."""
    requests = folder / "requests"
    requests.mkdir(parents=True, exist_ok=True)
    (folder / "openapi.json").write_text(render(app))
    for earlier in requests.glob("*.json"):
        earlier.unlink()
    for path, method, operation in _operations(app.openapi()):
        example = _example_request(path, method, operation)
        (requests / f"{example.operation_id}.json").write_text(example.render())


def _operations(document: dict[str, Any], part: str = "paths") -> Iterator[tuple[str, str, dict[str, Any]]]:
    for path, item in document[part].items():
        yield from ((path, method, operation) for method, operation in item.items())


def _finish(document: dict[str, Any], rules: RouteRules) -> dict[str, Any]:
    components = document.setdefault("components", {})
    schemas = components.setdefault("schemas", {})
    for generated in ("HTTPValidationError", "ValidationError"):
        schemas.pop(generated, None)
    problem = Problem.model_json_schema(ref_template="#/components/schemas/{model}")
    schemas |= problem.pop("$defs") | {problem["title"]: problem}
    # Each schema is named by its title: pydantic calls a page of scans `Page_Scan_`; a named literal has no title.
    names = {name: schema.setdefault("title", name) for name, schema in schemas.items()}
    if len(set(names.values())) < len(names):
        raise ValueError(f"two schemas have one title: {sorted(names.items(), key=lambda pair: pair[1])}")
    for name, title in names.items():
        schemas[title] = schemas.pop(name)
    refer = {f"#/components/schemas/{name}": f"#/components/schemas/{title}" for name, title in names.items()}
    _replace_references(document, refer)
    components["headers"] = HEADERS
    components["securitySchemes"] = SECURITY_SCHEMES
    for _, _, message in _operations(document, "webhooks"):
        _drop_generated_refusal(message["responses"])
    for path, method, operation in _operations(document):
        rule = rules.by_pattern[path][method.upper()]
        # A service on loopback without keys needs no key.
        with_key = [{}, *({scheme: [rule.scope]} for scheme in SECURITY_SCHEMES)]
        operation["security"] = [] if isinstance(rule.needs, NoKey) else with_key
        _describe_repeats(operation)
        _drop_generated_refusal(operation["responses"])
        list_refusals(method.upper(), rule, operation)
        describe_answers(operation)
        # A parameter is left out and never null.
        for parameter in operation.get("parameters", []):
            parameter["schema"] = _not_null(parameter["schema"])
        _give_examples(operation, operation.pop(TRY, {}))
    upload = document["paths"]["/v1/uploads/{upload_id}"]
    headers_alone = {
        status: {name: value for name, value in answer.items() if name != "content"}
        for status, answer in upload["get"]["responses"].items()
    }
    upload["head"] = upload["get"] | {
        "responses": headers_alone,
        "operationId": "head_upload",
        "summary": "Get an upload's offset",
    }
    components["responses"] = _shared_refusals(operation["responses"] for _, _, operation in _operations(document))
    for part in (schemas, document["paths"], document["webhooks"]):
        write_for_generators(part, schemas)
    return document


def _replace_references(part: Any, refer: dict[str, str]) -> None:  # noqa: ANN401 - any JSON value
    """Replace references in place, at any depth."""
    for key, value in part.items() if isinstance(part, dict) else enumerate(part):
        if isinstance(value, dict | list):
            _replace_references(value, refer)
        elif isinstance(value, str) and value in refer:
            part[key] = refer[value]


def _shared_refusals(answers: Iterable[dict[str, Any]]) -> dict[str, Any]:
    """Replace the commonest refusal of each status in all operations by a reference, and return these refusals."""
    refusals = [(answer, status) for answer in answers for status in answer if status >= "400"]
    shared = {}
    for status in sorted({status for _, status in refusals}):
        same = [answer for answer, its_status in refusals if its_status == status]
        commonest = max((answer[status] for answer in same), key=[answer[status] for answer in same].count)
        name = HTTPStatus(int(status)).phrase.title().replace(" ", "")
        shared[name] = commonest
        for answer in same:
            if answer[status] == commonest:
                answer[status] = {"$ref": f"#/components/responses/{name}"}
    return shared


def _drop_generated_refusal(responses: dict[str, Any]) -> None:
    """Remove FastAPI's description of a refused value, whose shape this service does not answer."""
    if CODES_KEY not in responses.get("422", {}):
        responses.pop("422", None)


def _not_null(schema: dict[str, Any]) -> dict[str, Any]:
    choices = [choice for choice in schema.get("anyOf", []) if choice != NULL]
    return choices[0] | {key: value for key, value in schema.items() if key != "anyOf"} if len(choices) == 1 else schema


def _describe_repeats(operation: dict[str, Any]) -> None:
    """Add the header that marks a repeat's answer to the answers of operations that may be repeated."""
    if any(parameter["name"] == "Idempotency-Key" for parameter in operation.get("parameters", [])):
        replayed = {"description": "This answer repeats an earlier one.", "schema": {"type": "string", "const": "true"}}
        for status, response in operation["responses"].items():
            if status.startswith("2"):
                response.setdefault("headers", {})["Idempotency-Replayed"] = replayed


def _give_examples(operation: dict[str, Any], values: dict[str, Any]) -> None:
    for parameter in operation.get("parameters", []):
        name, examples = parameter["name"], parameter["schema"].get("examples")
        if name in values:
            parameter["example"] = values[name]
        elif parameter["required"] and examples:
            parameter["example"] = examples[0]
    if "body" in values:
        [media] = operation["requestBody"]["content"].values()
        media["example"] = values["body"]


def _example_request(path: str, method: str, operation: dict[str, Any]) -> ExampleRequest:
    parameters = [parameter for parameter in operation.get("parameters", []) if "example" in parameter]
    headers = {parameter["name"]: str(parameter["example"]) for parameter in parameters if parameter["in"] == "header"}
    for parameter in parameters:
        if parameter["in"] == "path":
            path = path.replace(f"{{{parameter['name']}}}", str(parameter["example"]))
    content = operation.get("requestBody", {}).get("content", {})
    media_type = next(iter(content), None)
    return ExampleRequest(
        operation_id=operation["operationId"],
        method=method.upper(),
        path=path,
        headers=headers,
        query={parameter["name"]: parameter["example"] for parameter in parameters if parameter["in"] == "query"},
        body=content[media_type].get("example") if media_type else None,
        body_file=operation.get("x-example-file"),
        media_type=media_type,
    )


Schema = dict[str, Any]

NULL = {"type": "null"}


def write_for_generators(part: Any, schemas: Mapping[str, Schema]) -> None:  # noqa: ANN401 - any JSON value
    """Rewrite a part of the document in place, at any depth.

    - Titles go: generators name a class by each.
    - "X or null" of a plain X is a list of types: generators make a class for each `anyOf`.
    - A pair states the type of its items, for generators that ignore `prefixItems`. Its length already forbids further
      items; `items: false` would repeat that, and openapi-python-client refuses it.
    - A choice requires its discriminator, although it has a default in the schema of each kind.
    - A value's default is its example, unless it has others.
    """
    if isinstance(part, list):
        for inner in part:
            write_for_generators(inner, schemas)
    if not isinstance(part, dict):
        return
    for name, inner in part.items():
        if name not in {"example", "examples", "default"}:
            write_for_generators(inner, schemas)
    if isinstance(part.get("title"), str):
        del part["title"]
    if "prefixItems" in part:
        [kind] = {item["type"] for item in part["prefixItems"]}
        part["items"] = part["prefixItems"][0] if kind == "array" else {"type": kind}
    if isinstance(part.get("discriminator"), dict):
        name = part["discriminator"]["propertyName"]
        for reference in part["discriminator"]["mapping"].values():
            kind = schemas[reference.rpartition("/")[2]]
            kind["properties"][name].pop("default", None)
            kind["required"] = sorted({*kind.get("required", []), name})
    if {"default", "description"} <= part.keys():
        part.setdefault("examples", [part["default"]])
    _join_null(part)


def _join_null(part: Schema) -> None:
    """Make one schema of "X or null", if X is plain."""
    choices = [choice for choice in part.get("anyOf", []) if choice != NULL]
    if len(choices) != 1 or not isinstance(choices[0].get("type"), str):
        return
    del part["anyOf"]
    part |= choices[0] | part | {"type": [choices[0]["type"], "null"]}
    if "const" in part:
        part["enum"] = [part.pop("const"), None]
    elif "enum" in part:
        part["enum"] = [*part["enum"], None]
    if "minimum" in part:  # the smallest value of a request, above the bound that excludes 0
        part.pop("exclusiveMinimum", None)
