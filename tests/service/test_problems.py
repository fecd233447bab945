"""Every refusal is a problem that names the value, and every code that the sources name has its page."""

import ast
import json
import re
from collections import defaultdict
from collections.abc import Iterator
from html import unescape
from pathlib import Path
from typing import Annotated

import pytest
from asgi import refusal
from fastapi import Depends, FastAPI, Query
from openapi_spec_validator import validate
from pydantic import SecretStr
from results import SCANNER_SPEC as SPEC

from sawmill_contracts.failure_codes import CODES
from sawmill_contracts.scans import ScanState
from sawmill_platform import errors
from sawmill_platform.contracts.jobs import Failure, FailureKind
from sawmill_platform.errors import StorageFull, StorageUnavailable
from sawmill_service.access import LOGIN
from sawmill_service.app import create_app
from sawmill_service.http.bodies.sent_json import check_query
from sawmill_service.http.problem_types import problem_types
from sawmill_service.http.problems import Problem, install
from sawmill_service.pages.frame.languages import texts
from sawmill_service.settings import ServiceSettings

# Of a path's parameters.
ANY = defaultdict(lambda: "example", index="0")
JSON, SLICE = {"Content-Type": "application/json"}, "/v1/reconstructions/example/slices/0.png"


def problem(answer):
    assert answer.headers["Content-Type"] == "application/problem+json"
    found = Problem.model_validate(answer.json())
    assert found.status == answer.status_code
    assert found.type.endswith(found.code)
    return found


def test_a_refused_value_is_named_quoted_and_pointed_at(client):
    constants = {**SPEC["constants"], "source_to_cor_mm": -3, "pitch": 1}
    found = problem(client.post("/v1/scanners", json={"name": "", "constants": constants}))
    assert found.status == 422
    sentences = {error.location: error.message for error in found.errors}
    assert sentences["body.constants.source_to_cor_mm"] == "should be greater than 0, not -3"
    assert sentences["body.constants.pitch"] == "is not a known field"
    assert found.detail.endswith("(and 2 more)")
    shapes = [{"kind": "disc", "center_mm": [0], "radius_mm": -1, "a/b~c ä": 1}]
    answer = client.post("/v1/phantoms", json={"shapes": shapes})
    pointers = {error.pointer for error in problem(answer).errors}
    below = "#/shapes/0"
    assert pointers == {"#/name", f"{below}/center_mm/1", f"{below}/radius_mm", f"{below}/a~1b~0c%20%C3%A4"}
    assert answer.json()["errors"][0]["in"] == "body"
    listed = client.get("/v1/scanners", params={"limit": 0}).json()["errors"][0]
    assert (listed["in"], listed["parameter"], listed["location"]) == ("query", "limit", "query.limit")
    assert "pointer" not in listed
    path = client.get("/v1/scanners/NO").json()["errors"][0]
    assert (path["in"], path["parameter"]) == ("path", "scanner_id")
    broken = client.post("/v1/scanners", content="{", headers={"Content-Type": "application/json"}).json()["errors"][0]
    assert (broken["in"], broken["pointer"]) == ("body", "#")


NUMBERS = [json.dumps(SPEC).replace("859.46", number) for number in ("NaN", "Infinity", "1e999")]


def test_an_unknown_path_a_wrong_method_and_what_is_not_json_are_problems(client):
    answer = client.post("/v1/scanners", content=json.dumps(SPEC), headers={"Content-Type": "text/plain"})
    assert problem(answer).detail == "body must be JSON, with Content-Type: application/json"
    found = problem(client.get("/v1/scaners"))
    assert (found.status, found.code, found.instance) == (404, "unknown-path", "/v1/scaners")
    found = problem(client.post("/v1/scanners", json={**SPEC, "handedness": "x" * 10_000}))
    assert len(found.detail) < 300
    for identifier in ("EXAMPLE", "..%2f..%2fetc", "a" * 65, "%00", "-x", "é", "a b"):
        assert problem(client.get(f"/v1/scanners/{identifier}")).status in {404, 422}, identifier
    for body in ('{"name": ', "[1, 2", "\xff\xfe", '{"name": "a"} trailing', *NUMBERS):
        answer = client.post("/v1/scanners", content=body.encode("latin-1"), headers=JSON)
        assert problem(answer).status in ({422} if body in NUMBERS else {400, 422}), body
    for asked, allowed in {
        "POST /v1/scanners/example/history": "GET, HEAD",
        "PATCH /v1/scanners": "GET, HEAD, POST",
        "POST /v1/scanners/example": "DELETE, GET, HEAD, PUT",
        "POST /docs": "GET, HEAD",
        "GET /operator/activate/example": "POST",
        "GET /v1/phantoms/pictures": "POST",
        "DELETE /v1/keys/current": "GET, HEAD",
    }.items():
        answer = client.request(*asked.split())
        assert (problem(answer).code, answer.headers["Allow"]) == ("method-not-allowed", allowed), asked


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


def test_storage_trouble_is_reported_and_an_unexpected_error_gives_nothing_away(client, store):
    for error, status in ((StorageFull("it is full"), 507), (StorageUnavailable("away"), 503)):
        store.scanners = Failing(error)
        found = problem(client.get("/v1/scanners"))
        assert (found.status, found.code, found.detail) == (status, error.code, str(error))
    store.scanners = Failing(RuntimeError("the secret"))
    answer = client.get("/v1/scanners")
    assert problem(answer).code == "internal"
    assert "secret" not in answer.text
    assert answer.headers["X-Content-Type-Options"] == "nosniff"


class Failing:
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
    operations += [message["post"] for message in document["webhooks"].values()]
    used, described = {tag for o in operations for tag in o["tags"]}, {tag["name"] for tag in document["tags"]}
    assert used == described, "mend TAGS in service/sawmill_service/app.py"
    assert len({o["operationId"] for o in operations}) == len(operations)
    assert "HTTPValidationError" not in document["components"]["schemas"]


def test_a_field_of_a_query_is_refused_where_it_is_unknown_or_stands_twice_but_on_pages_for_people(seeded):
    for path, sentence in {
        "/v1/jobs?limt=3": "limt is not a known field: 'limit' is",
        "/v1/scanners/example?verbose=1": "verbose is not a known field",
        "/v1/calibrations/example/report.png?colour=red": "colour is not a known field",
        "/health/live?x=": "x is not a known field",
        f"{SLICE}?window_hi=1": "window_hi is not a known field: 'window_high' is",
        "/v1/jobs?limit=1&limit=2": "limit takes one value, not 2: ['1', '2']",
        "/v1/jobs/example?wait=0&wait=0&wait=5": "wait takes one value, not 3: ['0', '0', '5']",
        "/v1/events?after=1&%61fter=2": "after takes one value, not 2: ['1', '2']",
    }.items():
        found = problem(seeded.get(path))
        assert (found.status, found.code, found.detail) == (422, "invalid-request", f"query.{sentence}")
    for path in ("/", "/calibrate", "/docs"):
        assert seeded.get(f"{path}?from=an-old-bookmark&from=twice").status_code == 200
    for path in ("/jobs", "/phantoms"):
        assert seeded.get(f"{path}?from=an-old-bookmark").status_code == 422
    for span in ("frobs=1-", "bytes=9-2", "bytes=99999999-"):
        answer = seeded.get("/static/mark.svg", headers={"Range": span})
        assert (answer.status_code, answer.content[:4], "Accept-Ranges" in answer.headers) == (200, b"<svg", False)


def test_a_field_of_a_body_is_refused_where_it_stands_twice_and_a_list_in_a_query_is_taken(client):
    for path, body, pointer, sentence in (
        ("keys", '{"scope": "read", "scope": "admin"}', "#/scope", "scope takes one value, not 2: ['read', 'admin']"),
        (
            *("phantoms", '{"name": "x", "shapes": [1, {"a": [{"p/q": 1, "p\\u002fq": 1, "p/q": {}}]}]}'),
            *("#/shapes/1/a/0/p~1q", "shapes.1.a.0.p/q takes one value, not 3: [1, 1, {}]"),
        ),
        # The one that stands there and not the one within a value that was dropped.
        ("scanners", '{"name": {"a": 1, "a": 2}, "name": {}}', "#/name", None),
    ):
        found = problem(client.post(f"/v1/{path}", content=body, headers=JSON))
        assert (found.status, found.code) == (422, "invalid-request")
        assert [error.pointer for error in found.errors] == [pointer]
        assert sentence is None or found.detail == f"body.{sentence}"
    app = client.app = FastAPI(dependencies=[Depends(check_query)])
    install(app)

    @app.get("/logs")
    def logs(rows: Annotated[list[int] | None, Query()] = None, limit: int = 1) -> list[int]:
        return [*(rows or []), limit]

    assert client.get("/logs?rows=3&rows=4&limit=5").json() == [3, 4, 5]
    assert client.get("/logs?rows=3&limit=5&limit=5").status_code == 422


def test_every_operation_refuses_an_unknown_field_and_one_that_stands_twice(seeded):
    """Before anything else is looked at but the scope: nothing is made, deleted or drawn."""
    taken = []
    for path, operations in seeded.app.openapi()["paths"].items():
        address = path.format_map(ANY)
        for method, operation in operations.items():
            answer = seeded.request(method.upper(), address, params={"no-such-field": "1"})
            if method == "head":
                assert (answer.status_code, answer.content) == (422, b"")
                continue
            assert refusal(answer) == (422, "invalid-request"), (method, path)
            assert "query.no-such-field is not a known field" in answer.text
            if "application/json" in operation.get("requestBody", {}).get("content", {}):
                body = '{"no-such-field": 1, "no-such-field": 1}'
                answer = seeded.request(method.upper(), address, content=body, headers=JSON)
                detail = "body.no-such-field takes one value, not 2: [1, 1]"
                assert (answer.status_code, answer.json()["detail"]) == (422, detail), (method, path)
                taken.append(path)
    assert len(taken) > 10


@pytest.mark.parametrize("opened", ["[", '{"a": '], ids=["lists", "objects"])
def test_bodies_of_every_depth_are_answered(client, opened):
    """However deep a body may be that can be read at all: what is looked for in it is found there, too."""
    closed, answered = "]" if opened == "[" else "}", set()
    for depth in range(840, 1000, 8):
        for inner in ("0", '{"b": 1, "b": 1}'):
            nested = f"{opened * depth}{inner}{closed * depth}"
            answer = client.post("/v1/keys", content=f'{{"name": "k", "scope": {nested}}}', headers=JSON)
            answered.add(answer.status_code)
            wanted = "takes one value, not 2" if "b" in inner else "body cannot be read: recursion limit exceeded"
            assert answer.status_code == 400 or wanted in answer.json()["detail"]
    assert answered == {400, 422}


def kind_of(schema):
    kinds = schema.get("type")
    return kinds[0] if isinstance(kinds, list) else kinds


def spoilt(document, schema, types, value, place="body"):
    """What the schema describes, with the value wherever one of these types belongs; and all these places."""
    if "$ref" in schema:
        schema = document["components"]["schemas"][schema["$ref"].rpartition("/")[2]]
    if "anyOf" in schema:
        schema = next(part for part in schema["anyOf"] if part.get("type") != "null")
        return spoilt(document, schema, types, value, place)
    if "const" in schema:
        return schema["const"], []
    if kind_of(schema) == "array":
        items = schema.get("items", {})
        parts = dict(enumerate(schema.get("prefixItems") or items.get("oneOf") or [items]))
    else:
        parts = schema.get("properties", {})
    if not parts:
        return (value, [place]) if kind_of(schema) in types else (None, [])
    found = {name: spoilt(document, part, types, value, f"{place}.{name}") for name, part in parts.items()}
    kept = {name: part for name, (part, places) in found.items() if places or "const" in parts[name]}
    places = [each for _, within in found.values() for each in within]
    return (list(kept.values()) if kind_of(schema) == "array" else kept), places


def spoilt_bodies(document, types, value):
    """For each operation that takes JSON: its method, its path, a body as above, and the places."""
    for path, operations in document["paths"].items():
        for method, operation in operations.items():
            content = operation.get("requestBody", {}).get("content", {}).get("application/json")
            body, places = spoilt(document, content["schema"], types, value) if content else (None, [])
            if places:
                yield method.upper(), re.sub("[{}]", "", path).replace("_", "-"), body, places


def test_every_value_of_every_body_is_of_its_type_and_within_bounds(client):
    for types, value in (
        ({"number", "integer"}, True),
        ({"number", "integer"}, "714.7"),
        ({"integer"}, 3.5),
        ({"boolean"}, "off"),
        ({"boolean"}, 1),
        ({"string"}, "a\x00b"),
        ({"number"}, 1e308),
        ({"number"}, -1e308),
        ({"integer"}, 10**30),
    ):
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
    if kind_of(schema) in {"number", "integer"} and len(bounds) < 2:
        yield place
    for part in [*schema.get("anyOf", []), *schema.get("oneOf", [])]:
        yield from unbounded(document, part, place, bounds)
    for name, part in [*schema.get("properties", {}).items(), *enumerate(schema.get("prefixItems", []))]:
        yield from unbounded(document, part, f"{place}.{name}")
    if "items" in schema and "prefixItems" not in schema:
        yield from unbounded(document, schema["items"], place)


def test_every_number_has_its_bounds_in_the_document_and_is_taken_as_programs_write_it(client):
    document = client.app.openapi()
    operations = [operation for item in document["paths"].values() for operation in item.values()]
    contents = [operation["requestBody"]["content"] for operation in operations if "requestBody" in operation]
    bodies = [media["schema"] for content in contents for media in content.values()]
    assert {place for body in bodies for place in unbounded(document, body, "body")} == set()
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


def test_a_name_with_control_characters_and_a_day_as_seconds_are_refused(client):
    found = problem(client.post("/v1/scanners", content=json.dumps({**SPEC, "name": "\ud800"}), headers=JSON))
    assert found.detail.startswith("body cannot be read: ")
    for name, seen in (("a\x00b", r"'a\x00b'"), ("Line\u202e2", r"'Line\u202e2'"), ("two\nlines", r"'two\nlines'")):
        found = problem(client.post("/v1/scanners", json={**SPEC, "name": name}))
        assert found.detail.startswith("body.name must be without control characters and invisible ones, not with U+")
        assert found.detail.endswith(seen)
        asked = client.post("/v1/scans", params={"scanner_id": "line-2", "data": "counts", "name": name}, content=b"x")
        assert problem(asked).detail.startswith("query.name must be without control characters")
    measurement = {"dimension": "x", "measured_mm": 100, "standard_uncertainty_mm": 0.1}
    drawing = {"name": "disc", "shapes": [{"kind": "disc", "center_mm": [0, 0], "radius_mm": 50}]}
    for name in ("measured_on", "expires_on"):
        for value in (20, 1772409600, "1772409600", "20260331", "2026-02-30", "2026-03-31T00:00:00Z"):
            dated = {**measurement, name: value}
            found = problem(client.post("/v1/phantoms", json={**drawing, "measurements": [dated]}))
            assert found.errors[0].location == f"body.measurements.0.{name}"
            assert value == "2026-02-30" or "should be a valid date, not" in found.detail
    dated = {**measurement, "measured_on": "2026-03-31", "expires_on": "2027-03-31"}
    assert client.post("/v1/phantoms", json={**drawing, "measurements": [dated]}).status_code == 201


ROOT = Path(__file__).parents[2]
SOURCES = [*(ROOT / "service").rglob("*.py"), *(ROOT / "worker").rglob("*.py")]
# Where the code stands among the arguments, and how it is made of what stands there.
CODES_AT = {
    "Refused": (1, "{}"),
    "problem_response": (2, "{}"),
    **dict.fromkeys(("Busy", "Conflict", "Invalid", "OutOfRange", "NotStored"), (0, "{}")),
    "check_index": (0, "{}-out-of-range"),
    "NotFound": (0, "{}-not-found"),
    "found": (2, "{}-not-found"),
    "refuse_taken": (2, "{}-exists"),
}
# Expressions there that are no literals: what they can be.
FILES = ("scan.h5", "volume.h5", "result.h5", "thumbnail.png", "report.png", "overlay.png", "log-before.png")
MADE = {
    "f'scan-{scan.state}'": [f"scan-{state}" for state in ScanState if state is not ScanState.READY],
    "name.replace('.', '-')": [f"{name.replace('.', '-')}-not-found" for name in (*FILES, "log-after.png")],
}
# Expressions whose values are found at other calls, which name a literal.
PASSED_ON = {
    *("code", "kind", "noun", "refused.code", "error.code", "path.name.replace('.', '-')", "declared.noun"),
    *("f'{kind}-exists'", "f'{name}-out-of-range'"),
}
OWN_CODES = ("UploadTooLarge", "QueueFull", "Damaged", "StorageFull", "StorageUnavailable")


def assigned_codes() -> Iterator[str]:
    """As in `code, detail = "unknown-path", "..."`."""
    for node in ast.walk(ast.parse((ROOT / "service/sawmill_service/http/problems.py").read_text())):
        if (
            isinstance(node, ast.Assign)
            and isinstance(node.targets[0], ast.Tuple)
            and isinstance(node.value, ast.Tuple)
        ):
            name, value = node.targets[0].elts[0], node.value.elts[0]
            if ast.unparse(name) == "code" and isinstance(value, ast.Constant):
                yield value.value


def calls() -> Iterator[tuple[str, ast.Call]]:
    """The name and the node of each call in a source that has one of ours: to parse all takes seconds."""
    ours = re.compile(rf"\b(?:{'|'.join(CODES_AT)})\(|\bnoun=")
    for text in filter(ours.search, (path.read_text() for path in SOURCES)):
        for node in ast.walk(ast.parse(text)):
            if isinstance(node, ast.Call):
                yield getattr(node.func, "id", None) or getattr(node.func, "attr", ""), node


def literals(node: ast.expr) -> list[str] | None:
    """What an expression can be: one text, or those between which it chooses; None: anything."""
    if isinstance(node, ast.Constant):
        return [node.value]
    if isinstance(node, ast.IfExp):
        return [*(literals(node.body) or ()), *(literals(node.orelse) or ())]
    return MADE.get(ast.unparse(node))


def answered_codes() -> set[str]:
    found = ({getattr(errors, name).code for name in OWN_CODES} | {errors.DamagedResult.code}) | set(assigned_codes())
    for name, call in calls():
        at, shape = CODES_AT.get(name, (99, ""))
        if len(call.args) > at:
            codes = literals(call.args[at])
            unknown = codes is None and ast.unparse(call.args[at]) not in PASSED_ON
            assert not unknown, f"which codes can {ast.unparse(call)} have?"
            made = ast.unparse(call.args[at]) in MADE
            found |= {code if made else shape.format(code) for code in codes or ()}
        nouns = [keyword.value.value for keyword in call.keywords if keyword.arg == "noun"]
        found |= {f"{noun}-{what}" for noun in nouns for what in ("not-found", "exists")}
    return found


@pytest.mark.slow
def test_every_code_in_the_sources_has_its_texts():
    answered = answered_codes()
    assert len(answered) > 70  # else the search finds nothing
    known = {code for code, kind in problem_types().items() if kind.status is not None}
    assert not answered - known, "add these to problem_texts/answers.toml"
    assert not known - answered, "nothing answers with these: remove them from problem_texts, or their status"


def test_every_failure_s_code_has_its_texts():
    known = {code for code, kind in problem_types().items() if kind.failure is not None}
    assert not CODES - known, "add these to problem_texts/failures.toml"
    assert not known - CODES, "no job fails with these: take `failure` out of their texts"
    assert all(kind.status or kind.failure for kind in problem_types().values())


def test_a_problem_leads_to_its_page_which_whoever_was_refused_can_read(client, store):
    problem = client.get("/v1/scanners/nowhere").json()
    assert problem["type"] == "/problems/scanner-not-found"
    kind = client.get(problem["type"]).json()
    assert (kind["code"], kind["title"], kind["status"]) == (problem["code"], problem["title"], 404)
    assert kind["when"]
    assert kind["what_to_do"]
    assert kind in client.get("/problems/").json()["items"]
    assert client.get("/problems/invented").json()["code"] == "unknown-path"
    client.app = create_app(ServiceSettings(token=SecretStr("t" * 40)), store, print)
    refused = client.get("/v1/scanners")
    assert (refused.status_code, client.get(refused.json()["type"]).json()["status"]) == (401, 401)
    assert LOGIN in client.get(refused.json()["type"], headers={"Accept": "text/html"}).text
    store.keys = store.sessions = None
    assert client.get("/problems/storage-unavailable", headers={"Authorization": "Bearer wrong"}).status_code == 200


@pytest.mark.parametrize("language", ["en", "fi"])
def test_each_end_of_a_job_has_a_page_for_technicians_in_their_language(client, language):
    headers, text = {"Accept": "text/html", "Accept-Language": language}, texts(language)
    for code in CODES:
        kind, page = problem_types()[code], client.get(f"/problems/{code}", headers=headers)
        content = unescape(page.text[page.text.index("<main") : page.text.index("</main>")])
        assert page.status_code == 200, code
        assert f'<html lang="{language}"' in page.text
        for sentence in (kind.title, kind.when, kind.what_to_do):
            assert text.gettext(sentence) in content, code
        assert not re.search(r"HTTP|GET|POST|/v1/|request|`", content), code
        assert language == "en" or 'lang="en"' not in content, code
    listed = client.get("/problems", headers=headers, follow_redirects=True).text
    assert all(f'href="{kind.type}"' in listed for kind in problem_types().values())


@pytest.mark.parametrize(
    ("asked", "pages"),
    [
        ("drifts", ["/scanners/example", "/jobs", "/jobs/{job_id}/history"]),
        ("calibrations", ["/scanners/example", "/jobs"]),
        ("reconstructions", ["/logs", "/logs/{id}", "/jobs"]),
    ],
)
def test_a_failure_leads_to_what_its_code_means_wherever_it_is_shown(seeded, store, worker, asked, pages):
    made = seeded.post(f"/v1/{asked}", json={"scan_id": "example"}).json()
    store.jobs.fail(worker.claim(), Failure(kind=FailureKind.INPUT, code="too-few-views", detail="12 are too few"))
    for page in pages:
        shown = seeded.get(page.format_map(made), headers={"Accept": "text/html"}).text
        assert "12 are too few" in shown, page
        assert 'href="/problems/too-few-views"' in shown, page
