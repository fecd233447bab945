"""Every property and parameter of the OpenAPI document has a description, a unit and an example that is valid."""

import json
import re
from collections import Counter
from datetime import UTC, datetime

import pytest
from jsonschema import Draft202012Validator

from sawmill_platform.contracts.events import Event
from sawmill_platform.settings import StorageSettings
from sawmill_service.app import create_app
from sawmill_service.http.document.openapi_words import unit_of
from sawmill_service.settings import ServiceSettings
from sawmill_service.webhooks.couriers import body_of_event
from sawmill_store.store import Store

# How a description states what a number counts or that it has no unit.
STATED = re.compile(
    r"\bunits?\b|\bmm|1/mm|rad\b|degree|second|byte|per cent|%|[Nn]umber|count|pixel|attenuation", re.IGNORECASE
)


@pytest.fixture(scope="module")
def document(tmp_path_factory):
    store = Store.open(StorageSettings(data_folder=tmp_path_factory.mktemp("data"), database_url=None))
    yield create_app(ServiceSettings(), store, print).openapi()
    store.close()


def schemas(document):
    return document["components"]["schemas"]


def properties(document):
    for title, schema in schemas(document).items():
        for name, described in schema.get("properties", {}).items():
            yield f"{title}.{name}", name, described, described


def parameters(document):
    for path, operations in document["paths"].items():
        for method, operation in operations.items():
            for parameter in operation.get("parameters", []):
                yield f"{method} {path} {parameter['name']}", parameter["name"], parameter, parameter["schema"]


def everything(document):
    yield from properties(document)
    yield from parameters(document)


def kinds(schema):
    """The types that a value may have, those of an array's items too."""
    for each in (schema, *schema.get("anyOf", []), *schema.get("prefixItems", [])):
        yield each.get("type")
    if isinstance(schema.get("items"), dict):
        yield from kinds(schema["items"])


def test_names_are_short_and_titles_are_names(document):
    for name, schema in schemas(document).items():
        assert re.fullmatch(r"[A-Z][A-Za-z0-9]{1,29}", name), name
        assert schema["title"] == name
        assert schema.get("description"), name


def test_choices_of_words_are_types_of_their_own(document):
    inline = [where for where, _, _, schema in everything(document) if "enum" in str(schema.get("enum", ""))]
    inline += [
        where for where, _, _, schema in everything(document) for each in schema.get("anyOf", []) if "enum" in each
    ]
    assert inline == []
    states = [where for where, name, _, schema in properties(document) if name == "state" and "JobState" in str(schema)]
    assert {"Job.state", "Drift.state", "Plan.state", "Reconstruction.state", "Inspection.state"} <= set(states)
    values = Counter(tuple(schema["enum"]) for schema in schemas(document).values() if "enum" in schema)
    assert max(values.values()) == 1


def test_every_property_and_parameter_has_a_description_a_unit_and_valid_examples(document):
    assert [where for where, _, described, _ in everything(document) if len(described.get("description", "")) < 5] == []
    # One key of all requests would be an example of what is refused.
    assert {name for _, name, _, schema in everything(document) if not schema.get("examples")} == {"Idempotency-Key"}
    for where, name, described, schema in everything(document):
        units = unit_of(name)
        if units and "number" in kinds(schema):
            assert any(word in described["description"] for word in units), where
        elif "number" in kinds(schema):
            assert STATED.search(described["description"]), f"{where}: {described['description']}"
    root = {"components": document["components"]}
    for where, _, _, schema in everything(document):
        validator = Draft202012Validator(schema | root, format_checker=Draft202012Validator.FORMAT_CHECKER)
        for example in schema.get("examples", []):
            assert [error.message for error in validator.iter_errors(example)] == [], where


def parts(document, place=""):
    """Every object of the document, with its place."""
    for name, value in document.items() if isinstance(document, dict) else enumerate(document):
        if isinstance(value, dict | list):
            yield from parts(value, f"{place}/{name}")
    if isinstance(document, dict):
        yield place, document


def test_linters_and_generators_find_what_they_look_for(document):
    assert (document["servers"], document["info"]["license"]["identifier"]) == ([{"url": "/"}], "Apache-2.0")
    pairs = [part for _, part in parts(document) if "prefixItems" in part]
    assert [pair for pair in pairs if {pair["items"]["type"]} != {item["type"] for item in pair["prefixItems"]}] == []
    assert [pair for pair in pairs if pair["maxItems"] != len(pair["prefixItems"])] == []
    assert [place for place, part in parts(document) if {"minimum", "exclusiveMinimum"} <= part.keys()] == []
    names = [part["operationId"] for _, part in parts(document) if isinstance(part.get("operationId"), str)]
    assert [name for name, number in Counter(names).items() if number > 1] == []


def test_the_example_of_every_body_is_valid(document):
    root = {"components": document["components"]}
    bodies = [
        part for place, part in parts(document["paths"]) if "/requestBody/content/" in place and "example" in part
    ]
    assert len(bodies) > 10
    for media in bodies:
        Draft202012Validator(media["schema"] | root).validate(media["example"])


def test_a_message_to_a_webhook_is_as_described(document):
    message = document["webhooks"]["event"]["post"]["requestBody"]["content"]["application/json"]["schema"]
    event = Event(number=42, at=datetime.now(UTC), what="alarm-opened", group_id="example", detail={"what": "drift"})
    validator = Draft202012Validator(message | {"components": document["components"]})
    validator.validate(json.loads(body_of_event(event)))
    assert not validator.is_valid(event.model_dump(mode="json"))


def test_successful_answers_are_described_and_required_parameters_come_first(document):
    assert "Successful Response" not in json.dumps(document)
    for _, operation in parts(document["paths"]):
        required = [parameter["required"] for parameter in operation.get("parameters", []) if "required" in parameter]
        assert required == sorted(required, reverse=True)
