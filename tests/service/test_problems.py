"""Every refusal is a problem that names the value; each number, truth value and text is taken as itself."""

import json
import re
from collections import defaultdict
from typing import Annotated

import pytest
from fastapi import Depends, FastAPI, Query
from openapi_spec_validator import validate
from results import SCANNER_SPEC as SPEC

from sawmill_platform.errors import StorageFull, StorageUnavailable
from sawmill_service.http.bodies.sent_json import check_query
from sawmill_service.http.problems import Problem, install

# Of a path's parameters.
ANY = defaultdict(lambda: "example", index="0")
JSON, SLICE = {"Content-Type": "application/json"}, "/v1/reconstructions/example/slices/0.png"


def problem(answer):
    assert answer.headers["Content-Type"] == "application/problem+json"
    found = Problem.model_validate(answer.json())
    assert found.status == answer.status_code
    assert found.type.endswith(found.code)
    return found


def test_a_refused_value_is_named_and_quoted(client):
    constants = {**SPEC["constants"], "source_to_cor_mm": -3, "pitch": 1}
    found = problem(client.post("/v1/scanners", json={"name": "", "constants": constants}))
    assert found.status == 422
    sentences = {error.location: error.message for error in found.errors}
    assert sentences["body.constants.source_to_cor_mm"] == "should be greater than 0, not -3"
    assert sentences["body.constants.pitch"] == "is not a known field"
    assert found.detail.endswith("(and 2 more)")


NUMBERS = [json.dumps(SPEC).replace("859.46", number) for number in ("NaN", "Infinity", "1e999")]


@pytest.mark.parametrize("body", ['{"name": ', "[1, 2", "\xff\xfe", '{"name": "a"} trailing', *NUMBERS])
def test_what_is_not_json_or_no_number_is_a_problem(client, body):
    answer = client.post("/v1/scanners", content=body.encode("latin-1"), headers=JSON)
    assert problem(answer).status == 422 or body not in NUMBERS
    assert answer.status_code in {400, 422}


def test_an_unknown_path_and_json_that_is_not_called_so_are_problems(client):
    answer = client.post("/v1/scanners", content=json.dumps(SPEC), headers={"Content-Type": "text/plain"})
    assert problem(answer).detail == "body must be JSON, with Content-Type: application/json"
    found = problem(client.get("/v1/scaners"))
    assert (found.status, found.code, found.instance) == (404, "unknown-path", "/v1/scaners")
    found = problem(client.post("/v1/scanners", json={**SPEC, "handedness": "x" * 10_000}))
    assert len(found.detail) < 300


@pytest.mark.parametrize(
    ("method", "path", "allowed"),
    [
        ("POST", "/v1/scanners/example/history", "GET, HEAD"),
        ("PATCH", "/v1/scanners", "GET, HEAD, POST"),
        ("POST", "/v1/scanners/example", "DELETE, GET, HEAD, PUT"),
        ("POST", "/docs", "GET, HEAD"),
        ("GET", "/operator/activate/example", "POST"),
        ("GET", "/v1/phantoms/pictures", "POST"),
        ("DELETE", "/v1/keys/own", "GET, HEAD"),
    ],
)
def test_a_wrong_method_is_a_problem_that_reports_which_is_right(client, method, path, allowed):
    answer = client.request(method, path)
    assert (problem(answer).code, answer.headers["Allow"]) == ("method-not-allowed", allowed)


@pytest.mark.slow
def test_allow_lists_what_each_path_takes(seeded):
    methods = {"GET", "HEAD", "POST", "PUT", "PATCH", "DELETE"}
    for path, operations in seeded.app.openapi()["paths"].items():
        address = path.format_map(ANY)
        documented = {method.upper() for method in operations}
        taken = documented | ({"HEAD"} if "GET" in documented else set())
        asked = seeded.request("OPTIONS", address)
        assert (asked.status_code, asked.headers["Allow"]) == (405, ", ".join(sorted(taken))), path
        # An unknown field is refused where the method is taken: nothing is made or deleted.
        answered = {each: seeded.request(each, address, params={"no-such-field": "1"}) for each in sorted(methods)}
        assert {each for each, answer in answered.items() if answer.status_code != 405} == taken, path
        refused = {answer.headers["Allow"] for each, answer in answered.items() if each not in taken}
        assert refused <= {asked.headers["Allow"]}, path


@pytest.mark.parametrize("identifier", ["EXAMPLE", "..%2f..%2fetc", "a" * 65, "%00", "-x", "é", "a b"])
def test_an_identifier_that_cannot_be_is_a_problem(client, identifier):
    assert problem(client.get(f"/v1/scanners/{identifier}")).status in {404, 422}


@pytest.mark.parametrize(
    ("error", "status", "code"),
    [(StorageFull("it is full"), 507, "storage-full"), (StorageUnavailable("away"), 503, "storage-unavailable")],
)
def test_storage_trouble_is_reported(client, store, error, status, code):
    store.scanners = Failing(error)
    found = problem(client.get("/v1/scanners"))
    assert (found.status, found.code, found.detail) == (status, code, str(error))


def test_an_unexpected_error_gives_nothing_away(client, store):
    store.scanners = Failing(RuntimeError("the secret"))
    answer = client.get("/v1/scanners")
    assert problem(answer).code == "internal"
    assert "secret" not in answer.text
    assert answer.headers["X-Content-Type-Options"] == "nosniff"


class Failing:
    """A resource of which every method raises."""

    def __init__(self, error):
        self.error = error

    def __getattr__(self, _):
        def fail(**_):
            raise self.error

        return fail


@pytest.mark.slow
def test_the_document_is_valid_openapi_and_answers_problems_everywhere(client):
    document = client.get("/openapi.json").json()
    validate(document)
    assert document["openapi"].startswith("3.1")
    operations = [operation for item in document["paths"].values() for operation in item.values()]
    assert not any("default" in o["responses"] for o in operations)
    assert all({"400", "421", "422", "429", "500", "503"} < o["responses"].keys() for o in operations)
    assert all(o["summary"] and o["description"] and o["tags"] for o in operations)
    used, described = {tag for o in operations for tag in o["tags"]}, {tag["name"] for tag in document["tags"]}
    assert used == described, "mend TAGS in service/sawmill_service/app.py"
    assert len({o["operationId"] for o in operations}) == len(operations)
    assert "HTTPValidationError" not in document["components"]["schemas"]


@pytest.mark.parametrize(
    ("path", "sentence"),
    [
        ("/v1/jobs?limt=3", "query.limt is not a known field: 'limit' is"),
        ("/v1/scanners/example?verbose=1", "query.verbose is not a known field"),
        ("/v1/calibrations/example/report.png?colour=red", "query.colour is not a known field"),
        ("/health/live?x=", "query.x is not a known field"),
        (f"{SLICE}?window_hi=1", "query.window_hi is not a known field: 'window_high' is"),
        ("/v1/jobs?limit=1&limit=2", "query.limit takes one value, not 2: ['1', '2']"),
        ("/v1/jobs/example?wait=0&wait=0&wait=5", "query.wait takes one value, not 3: ['0', '0', '5']"),
        ("/v1/events?after=1&%61fter=2", "query.after takes one value, not 2: ['1', '2']"),
    ],
)
def test_a_field_of_a_query_is_refused_where_it_is_unknown_or_stands_twice(seeded, path, sentence):
    found = problem(seeded.get(path))
    assert (found.status, found.code, found.detail) == (422, "invalid-request", sentence)


@pytest.mark.parametrize(
    ("path", "body", "pointer", "sentence"),
    [
        ("keys", '{"scope": "read", "scope": "admin"}', "#/scope", "scope takes one value, not 2: ['read', 'admin']"),
        (
            *("phantoms", '{"name": "x", "shapes": [1, {"a": [{"p/q": 1, "p\\u002fq": 1, "p/q": {}}]}]}'),
            *("#/shapes/1/a/0/p~1q", "shapes.1.a.0.p/q takes one value, not 3: [1, 1, {}]"),
        ),
        # The one that stands there and not the one within a value that was dropped.
        ("scanners", '{"name": {"a": 1, "a": 2}, "name": {}}', "#/name", None),
    ],
)
def test_a_field_of_a_body_is_refused_where_it_stands_twice(client, path, body, pointer, sentence):
    found = problem(client.post(f"/v1/{path}", content=body, headers=JSON))
    assert (found.status, found.code, [error.pointer for error in found.errors]) == (422, "invalid-request", [pointer])
    assert sentence is None or found.detail == f"body.{sentence}"


def test_every_operation_refuses_a_field_that_stands_twice_in_its_body(seeded):
    taken = []
    for path, operations in seeded.app.openapi()["paths"].items():
        for method, operation in operations.items():
            if "application/json" in operation.get("requestBody", {}).get("content", {}):
                body = '{"no-such-field": 1, "no-such-field": 1}'
                answer = seeded.request(method.upper(), path.format_map(ANY), content=body, headers=JSON)
                detail = "body.no-such-field takes one value, not 2: [1, 1]"
                assert (answer.status_code, answer.json()["detail"]) == (422, detail), (method, path)
                taken.append(path)
    assert len(taken) > 10


@pytest.mark.parametrize("opened", ["[", '{"a": '], ids=["lists", "objects"])
def test_bodies_of_every_depth_are_answered(client, opened):
    """However deep a body may be that can be read at all: what is looked for in it is found there, too."""
    closed = "]" if opened == "[" else "}"
    answered = set()
    for depth in range(840, 1000, 8):
        for inner in ("0", '{"b": 1, "b": 1}'):
            nested = f"{opened * depth}{inner}{closed * depth}"
            answer = client.post("/v1/keys", content=f'{{"name": "k", "scope": {nested}}}', headers=JSON)
            detail = answer.json()["detail"]
            answered.add(answer.status_code)
            wanted = "takes one value, not 2" if "b" in inner else "body cannot be read: recursion limit exceeded"
            assert answer.status_code == 400 or wanted in detail
    assert answered == {400, 422}


def test_pages_for_people_pass_over_what_they_do_not_know(seeded):
    for path in ("/", "/calibrate", "/docs"):
        assert seeded.get(f"{path}?from=an-old-bookmark&from=twice").status_code == 200
    for path in ("/jobs", "/phantoms"):
        assert seeded.get(f"{path}?from=an-old-bookmark").status_code == 422


def test_a_list_in_a_query_takes_several_values(client):
    app = client.app = FastAPI(dependencies=[Depends(check_query)])
    install(app)

    @app.get("/logs")
    def logs(rows: Annotated[list[int] | None, Query()] = None, limit: int = 1) -> list[int]:
        return [*(rows or []), limit]

    assert client.get("/logs?rows=3&rows=4&limit=5").json() == [3, 4, 5]
    assert client.get("/logs?rows=3&limit=5&limit=5").status_code == 422


def test_every_operation_refuses_an_unknown_field_of_a_query(seeded):
    """Before anything else is looked at but the scope: nothing is made, deleted or drawn."""
    for path, operations in seeded.app.openapi()["paths"].items():
        for method in operations:
            answer = seeded.request(method.upper(), path.format_map(ANY), params={"no-such-field": "1"})
            assert (answer.status_code, answer.json()["code"]) == (422, "invalid-request"), (method, path)
            assert "query.no-such-field is not a known field" in answer.text


@pytest.mark.parametrize("span", ["frobs=1-", "bytes=9-2", "bytes=99999999-"])
def test_a_range_of_a_page_s_own_file_is_passed_over(client, span):
    answer = client.get("/static/mark.svg", headers={"Range": span})
    assert answer.status_code == 200
    assert answer.content.startswith(b"<svg")
    assert "Accept-Ranges" not in answer.headers


def test_each_value_has_a_pointer_or_the_name_of_a_parameter(client):
    shapes = [{"kind": "disc", "center_mm": [0], "radius_mm": -1, "a/b~c ä": 1}]
    answer = client.post("/v1/phantoms", json={"shapes": shapes})
    errors = problem(answer).errors
    assert {error.pointer for error in errors} == {
        "#/name",
        "#/shapes/0/center_mm/1",
        "#/shapes/0/radius_mm",
        "#/shapes/0/a~1b~0c%20%C3%A4",
    }
    assert answer.json()["errors"][0]["in"] == "body"
    listed = client.get("/v1/scanners", params={"limit": 0}).json()["errors"][0]
    assert (listed["in"], listed["parameter"], listed["location"]) == ("query", "limit", "query.limit")
    assert "pointer" not in listed
    path = client.get("/v1/scanners/NO").json()["errors"][0]
    assert (path["in"], path["parameter"]) == ("path", "scanner_id")
    broken = client.post("/v1/scanners", content="{", headers={"Content-Type": "application/json"}).json()["errors"][0]
    assert (broken["in"], broken["pointer"]) == ("body", "#")


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
