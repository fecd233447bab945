"""What clients send is taken as itself: each number, truth value and text of every body in the OpenAPI document."""

import json
import re

import pytest
from results import SCANNER_SPEC as SPEC

from sawmill_service.http.problems import Problem

JSON = {"Content-Type": "application/json"}


def problem(answer):
    assert answer.status_code == 422
    return Problem.model_validate(answer.json())


def spoilt(document, schema, types, value, place="body"):
    """What the schema describes, with the value wherever one of these types belongs; and all these places."""
    if "$ref" in schema:
        schema = document["components"]["schemas"][schema["$ref"].rpartition("/")[2]]
    if "anyOf" in schema:
        schema = next(part for part in schema["anyOf"] if part.get("type") != "null")
        return spoilt(document, schema, types, value, place)
    if "const" in schema:
        return schema["const"], []
    if schema.get("type") == "array":
        items = schema.get("items", {})
        parts = dict(enumerate(schema.get("prefixItems") or items.get("oneOf") or [items]))
    else:
        parts = schema.get("properties", {})
    if not parts:
        return (value, [place]) if schema.get("type") in types else (None, [])
    found = {name: spoilt(document, part, types, value, f"{place}.{name}") for name, part in parts.items()}
    kept = {name: part for name, (part, places) in found.items() if places or "const" in parts[name]}
    places = [each for _, within in found.values() for each in within]
    return (list(kept.values()) if schema.get("type") == "array" else kept), places


def spoilt_bodies(document, types, value):
    """For each operation that takes JSON: its method, its path, a body as above, and the places."""
    for path, operations in document["paths"].items():
        for method, operation in operations.items():
            content = operation.get("requestBody", {}).get("content", {}).get("application/json")
            body, places = spoilt(document, content["schema"], types, value) if content else (None, [])
            if places:
                yield method.upper(), re.sub("[{}]", "", path).replace("_", "-"), body, places


@pytest.mark.parametrize(
    ("types", "value"),
    [
        ({"number", "integer"}, True),
        ({"number", "integer"}, "714.7"),
        ({"integer"}, 3.5),
        ({"boolean"}, "off"),
        ({"boolean"}, 1),
        ({"string"}, "a\x00b"),
        ({"number"}, 1e308),
        ({"number"}, -1e308),
        ({"integer"}, 10**30),
    ],
)
def test_every_value_of_every_body_is_of_its_type_and_within_bounds(client, types, value):
    passed = []
    for method, path, body, places in spoilt_bodies(client.app.openapi(), types, value):
        found = problem(client.request(method, path, content=json.dumps(body), headers=JSON))
        # Of a shape the location names the kind, which the place does not.
        named = {re.sub(r"\.(polygon|disc)\.", ".", error.location) for error in found.errors}
        passed += [(path, place) for place in places if place not in named]
    # A density is held against its bounds once the rest is right (test_phantoms).
    passed = [each for each in passed if isinstance(value, bool | str) or not each[1].endswith(".density")]
    assert not passed, passed


def unbounded(document, schema, place, bounds=frozenset()):
    """Yield the places of numbers without both bounds; a bound may stand beside the alternatives of a number."""
    if "$ref" in schema:
        schema = document["components"]["schemas"][schema["$ref"].rpartition("/")[2]]
    bounds |= {key[-7:].lower() for key in schema if key.lower().endswith(("minimum", "maximum"))}
    if schema.get("type") in {"number", "integer"} and len(bounds) < 2:
        yield place
    for part in [*schema.get("anyOf", []), *schema.get("oneOf", [])]:
        yield from unbounded(document, part, place, bounds)
    for name, part in [*schema.get("properties", {}).items(), *enumerate(schema.get("prefixItems", []))]:
        yield from unbounded(document, part, f"{place}.{name}")
    if "items" in schema and "prefixItems" not in schema:
        yield from unbounded(document, schema["items"], place)


def test_every_number_of_every_body_has_its_bounds_in_the_document(client):
    document = client.app.openapi()
    bodies = [
        content["schema"]
        for operations in document["paths"].values()
        for operation in operations.values()
        for content in operation.get("requestBody", {}).get("content", {}).values()
    ]
    assert {place for body in bodies for place in unbounded(document, body, "body")} == set()


def test_numbers_and_names_are_taken_as_programs_write_them(client):
    assert client.post("/v1/scanners", json={**SPEC, "log_radius_mm": 150}).status_code == 201
    for name in ("Säge 2", "線2", "خط ۲", "लाइन २", "Line\u00a02 🪵"):
        assert client.post("/v1/scanners", json={**SPEC, "name": name}).status_code == 201
    assert client.get("/v1/scans", params={"limit": "3"}).status_code == 200
    problem(client.get("/v1/scans", params={"limit": "three"}))
    spec = SPEC | {"constants": SPEC["constants"] | {"num_detector_pixels": 768.0}}
    created = client.post("/v1/scanners", json=spec)
    assert (created.status_code, created.json()["constants"]["num_detector_pixels"]) == (201, 768)
    wrong = problem(client.post("/v1/scanners", json={**spec, "log_radius_mm": True}))
    assert [error.location for error in wrong.errors] == ["body.log_radius_mm"], "768.0 is no fault beside another"
    body = b"\xef\xbb\xbf" + json.dumps(SPEC).encode()
    assert client.post("/v1/scanners", content=body, headers=JSON).status_code == 201


def test_a_day_is_no_number_of_seconds(client):
    measurement = {"what": "x", "measured_mm": 100, "standard_uncertainty_mm": 0.1}
    drawing = {"name": "disc", "shapes": [{"kind": "disc", "center_mm": [0, 0], "radius_mm": 50}]}
    for name in ("measured_on", "expires_on"):
        for value in (20, 1772409600, "1772409600", "20260331", "2026-02-30", "2026-03-31T00:00:00Z"):
            dated = {**measurement, name: value}
            found = problem(client.post("/v1/phantoms", json={**drawing, "measurements": [dated]}))
            assert found.errors[0].location == f"body.measurements.0.{name}"
            assert value == "2026-02-30" or "should be a valid date, not" in found.detail
    dated = {**measurement, "measured_on": "2026-03-31", "expires_on": "2027-03-31"}
    assert client.post("/v1/phantoms", json={**drawing, "measurements": [dated]}).status_code == 201


def test_half_a_surrogate_is_refused(client):
    found = problem(client.post("/v1/scanners", content=json.dumps({**SPEC, "name": "\ud800"}), headers=JSON))
    assert found.detail.startswith("body cannot be read: ")


@pytest.mark.parametrize(
    ("name", "seen"), [("a\x00b", r"'a\x00b'"), ("Line\u202e2", r"'Line\u202e2'"), ("two\nlines", r"'two\nlines'")]
)
def test_a_name_with_a_control_character_is_refused_and_quoted_safely(client, name, seen):
    found = problem(client.post("/v1/scanners", json={**SPEC, "name": name}))
    assert found.detail.startswith("body.name must be without control characters and invisible ones, not with U+")
    assert found.detail.endswith(seen)
    asked = client.post("/v1/scans", params={"scanner_id": "line-2", "data": "counts", "name": name}, content=b"x")
    assert problem(asked).detail.startswith("query.name must be without control characters")
