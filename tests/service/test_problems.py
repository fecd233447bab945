import json
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


def test_a_huge_value_is_not_echoed(client):
    found = problem(client.post("/v1/scanners", json={**SPEC, "handedness": "x" * 10_000}))
    assert len(found.detail) < 300


@pytest.mark.parametrize("body", ['{"name": ', "[1, 2", "\xff\xfe", '{"name": "a"} trailing'])
def test_what_is_not_json_is_a_problem(client, body):
    answer = client.post("/v1/scanners", content=body.encode("latin-1"), headers={"Content-Type": "application/json"})
    assert problem(answer).status in {400, 422}


@pytest.mark.parametrize("number", ["NaN", "Infinity", "1e999"])
def test_numbers_that_are_none_are_refused(client, number):
    body = json.dumps(SPEC).replace("859.46", number)
    answer = client.post("/v1/scanners", content=body, headers={"Content-Type": "application/json"})
    assert problem(answer).status == 422


def test_json_must_say_that_it_is_json(client):
    answer = client.post("/v1/scanners", content=json.dumps(SPEC), headers={"Content-Type": "text/plain"})
    assert problem(answer).detail == "body must be JSON, with Content-Type: application/json"


def test_an_unknown_path_is_a_problem(client):
    found = problem(client.get("/v1/scaners"))
    assert (found.status, found.code, found.instance) == (404, "unknown-path", "/v1/scaners")


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
    assert problem(answer).code == "method-not-allowed"
    assert answer.headers["Allow"] == allowed


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
    [
        (StorageFull("the disk is full"), 507, "storage-full"),
        (StorageUnavailable("the database is away"), 503, "storage-unavailable"),
    ],
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
        (
            "/v1/reconstructions/example/slices/0.png?window_hi=1",
            "query.window_hi is not a known field: 'window_high' is",
        ),
    ],
)
def test_an_unknown_field_of_a_query_is_refused_on_every_route(seeded, path, sentence):
    found = problem(seeded.get(path))
    assert (found.status, found.code, found.detail) == (422, "invalid-request", sentence)


@pytest.mark.parametrize(
    ("path", "sentence"),
    [
        ("/v1/jobs?limit=1&limit=2", "query.limit takes one value, not 2: ['1', '2']"),
        ("/v1/jobs/example?wait=0&wait=0&wait=5", "query.wait takes one value, not 3: ['0', '0', '5']"),
        ("/v1/events?after=1&%61fter=2", "query.after takes one value, not 2: ['1', '2']"),
    ],
)
def test_a_field_of_one_value_is_refused_where_it_stands_twice(seeded, path, sentence):
    found = problem(seeded.get(path))
    assert (found.status, found.code, found.detail) == (422, "invalid-request", sentence)


JSON = {"Content-Type": "application/json"}


@pytest.mark.parametrize(
    ("path", "body", "pointer", "sentence"),
    [
        (
            "/v1/keys",
            '{"name": "k", "scope": "read", "scope": "admin"}',
            "#/scope",
            "body.scope takes one value, not 2: ['read', 'admin']",
        ),
        (
            "/v1/phantoms",
            '{"name": "x", "shapes": [1, {"a": [{"p/q": 1, "p\\u002fq": 1, "p/q": {}}]}]}',
            "#/shapes/1/a/0/p~1q",
            "body.shapes.1.a.0.p/q takes one value, not 3: [1, 1, {}]",
        ),
        # The one that stands there and not the one within a value that was dropped.
        ("/v1/scanners", '{"name": {"a": 1, "a": 2}, "name": {}}', "#/name", None),
    ],
)
def test_a_field_of_a_body_is_refused_where_it_stands_twice(client, path, body, pointer, sentence):
    found = problem(client.post(path, content=body, headers=JSON))
    assert (found.status, found.code, [error.pointer for error in found.errors]) == (422, "invalid-request", [pointer])
    assert sentence in {None, found.detail}


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
    found = answer.json()["errors"][0]
    assert found["in"] == "body"
    listed = client.get("/v1/scanners", params={"limit": 0}).json()["errors"][0]
    assert (listed["in"], listed["parameter"], listed["location"]) == ("query", "limit", "query.limit")
    assert "pointer" not in listed
    path = client.get("/v1/scanners/NO").json()["errors"][0]
    assert (path["in"], path["parameter"]) == ("path", "scanner_id")
    broken = client.post("/v1/scanners", content="{", headers={"Content-Type": "application/json"}).json()["errors"][0]
    assert (broken["in"], broken["pointer"]) == ("body", "#")
