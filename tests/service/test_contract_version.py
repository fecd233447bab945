"""A contract that changed has a version that says so: held against that of the last release, openapi/released.json."""

import json
import re
import subprocess
import sys
from copy import deepcopy
from pathlib import Path

import pytest
import yaml
from contract_changes import compare, fault_of_version, needed_version
from contract_parts import Kind, without_words

from sawmill_vocabulary.version import VERSION

ROOT = Path(__file__).parents[2]
HEADINGS = re.compile(r"^## \[(.+)\] - (.+)$", re.MULTILINE)
ADDITION, INCOMPATIBLE = Kind.ADDITION, Kind.INCOMPATIBLE
TEXT, COUNT = {"type": "string"}, {"type": "integer"}


def an_object(required=(), **properties):
    return {"type": "object", "properties": properties, "required": list(required), "additionalProperties": False}


def kind_of(name, **properties):
    return an_object(["kind"], kind={"const": name}, **properties)


def either(*schemas):
    return {"anyOf": list(schemas)}


def one_of(*values):
    return {"type": "string", "enum": list(values)}


# What changed -> a schema before and after; what it is where a request has it, and where an answer has it; what it is
# the other way round.
SCHEMAS = {
    "a field more": (an_object(), an_object(a=TEXT), (ADDITION, ADDITION), (INCOMPATIBLE, INCOMPATIBLE)),
    "a required field more": (
        *(an_object(), an_object("a", a=TEXT)),
        *((INCOMPATIBLE, ADDITION), (INCOMPATIBLE, INCOMPATIBLE)),
    ),
    "required": (an_object(a=TEXT), an_object("a", a=TEXT), (INCOMPATIBLE, ADDITION), (ADDITION, INCOMPATIBLE)),
    "another type": (TEXT, COUNT, (INCOMPATIBLE, INCOMPATIBLE), (INCOMPATIBLE, INCOMPATIBLE)),
    "whole numbers": ({"type": "number"}, COUNT, (INCOMPATIBLE, ADDITION), (ADDITION, INCOMPATIBLE)),
    "null": (TEXT, either(TEXT, {"type": "null"}), (ADDITION, INCOMPATIBLE), (INCOMPATIBLE, ADDITION)),
    "null in a list of types": (
        *(TEXT, {"type": ["string", "null"]}),
        *((ADDITION, INCOMPATIBLE), (INCOMPATIBLE, ADDITION)),
    ),
    "a word more": (one_of("a"), one_of("a", "b"), (ADDITION, INCOMPATIBLE), (INCOMPATIBLE, ADDITION)),
    "words": (TEXT, one_of("a"), (INCOMPATIBLE, ADDITION), (ADDITION, INCOMPATIBLE)),
    "one word": (
        one_of("a", "b"),
        {"type": "string", "const": "a"},
        (INCOMPATIBLE, ADDITION),
        (ADDITION, INCOMPATIBLE),
    ),
    "a kind more": (
        *(either(kind_of("disc")), either(kind_of("polygon", a=TEXT), kind_of("disc"))),
        *((ADDITION, INCOMPATIBLE), (INCOMPATIBLE, ADDITION)),
    ),
    "least": (COUNT, COUNT | {"minimum": 1}, (INCOMPATIBLE, ADDITION), (ADDITION, ADDITION)),
    "more than": (
        *(COUNT | {"minimum": 1}, COUNT | {"exclusiveMinimum": 1}),
        *((INCOMPATIBLE, ADDITION), (ADDITION, ADDITION)),
    ),
    "most": (COUNT | {"maximum": 9}, COUNT | {"maximum": 8}, (INCOMPATIBLE, ADDITION), (ADDITION, ADDITION)),
    "longest": (TEXT | {"maxLength": 9}, TEXT | {"maxLength": 8}, (INCOMPATIBLE, ADDITION), (ADDITION, ADDITION)),
    "a pattern": (TEXT, TEXT | {"pattern": "^a"}, (INCOMPATIBLE, ADDITION), (ADDITION, ADDITION)),
    "another pattern": (
        *(TEXT | {"pattern": "^b"}, TEXT | {"pattern": "^a"}),
        *((INCOMPATIBLE, ADDITION), (INCOMPATIBLE, ADDITION)),
    ),
    "a rule between fields": (
        *(an_object(a=TEXT), an_object(a=TEXT) | {"dependentSchemas": {"a": {"required": ["b"]}}}),
        *((INCOMPATIBLE, ADDITION), (ADDITION, ADDITION)),
    ),
    "a format": (TEXT, TEXT | {"format": "date-time"}, (INCOMPATIBLE, ADDITION), (ADDITION, INCOMPATIBLE)),
    "a default": (COUNT | {"default": 1}, COUNT | {"default": 2}, (INCOMPATIBLE, None), (INCOMPATIBLE, None)),
    "any field": (
        *(an_object(), {"type": "object", "properties": {}}),
        *((ADDITION, ADDITION), (INCOMPATIBLE, ADDITION)),
    ),
    "items": (
        *({"type": "array", "items": TEXT}, {"type": "array", "items": COUNT}),
        *((INCOMPATIBLE, INCOMPATIBLE), (INCOMPATIBLE, INCOMPATIBLE)),
    ),
    "values by position": (
        *({"type": "array", "prefixItems": [TEXT]}, {"type": "array", "prefixItems": [TEXT, TEXT]}),
        *((INCOMPATIBLE, INCOMPATIBLE), (INCOMPATIBLE, INCOMPATIBLE)),
    ),
    "going out of use": (TEXT, TEXT | {"deprecated": True}, (ADDITION, ADDITION), (None, None)),
    "words for people": (TEXT, TEXT | {"description": "A name.", "examples": ["a"]}, (None, None), (None, None)),
    "a field that is called as words are": (
        *(an_object(), an_object(title=TEXT)),
        *((ADDITION, ADDITION), (INCOMPATIBLE, INCOMPATIBLE)),
    ),
}


def document(operation=None, *, types=None, paths=None):
    item = {"post": {"operationId": "make_log", "tags": ["logs"], "responses": {"201": {}}} | (operation or {})}
    return {
        "info": {"version": "1.2.3"},
        "paths": {"/logs": item} | (paths or {}),
        "components": {"schemas": types or {}},
    }


def asking(schema, *, required=True):
    return {"requestBody": {"required": required, "content": {"application/json": {"schema": schema}}}}


def answering(schema, **more):
    return {"responses": {"201": {"content": {"application/json": {"schema": schema} | more}}}}


def with_parameter(**described):
    return {"parameters": [{"in": "query", "name": "limit", "schema": COUNT} | described]}


def listed(**described):
    return document(with_parameter(schema={"type": "array", "items": COUNT}, **described))


def answered_with(*statuses):
    return document({"responses": {status: {} for status in statuses}})


def with_key(*scopes):
    return {"security": [{"key": [scope]} for scope in scopes]}


def refusing(*codes):
    return {"responses": {"201": {}, "409": {"x-problem-codes": list(codes)}}}


HEADED = {"responses": {"201": {"headers": {"Location": {"required": True, "schema": TEXT}}}}}
SOMETIMES_HEADED = {"responses": {"201": {"headers": {"Location": {"required": False, "schema": TEXT}}}}}
# What changed -> a document before and after, what it is, and what it is the other way round.
DOCUMENTS = {
    "a path": (document(), document(paths={"/more": {}}), ADDITION, INCOMPATIBLE),
    "a method": (document(paths={"/more": {}}), document(paths={"/more": {"get": {}}}), ADDITION, INCOMPATIBLE),
    "a type's name": (document(types={"A": TEXT}), document(types={"B": TEXT}), INCOMPATIBLE, INCOMPATIBLE),
    "a function's name": (document(), document({"operationId": "create"}), INCOMPATIBLE, INCOMPATIBLE),
    "a module's name": (document(), document({"tags": ["scans"]}), INCOMPATIBLE, INCOMPATIBLE),
    "out of use": (document(), document({"deprecated": True}), ADDITION, None),
    "a key": (document(), document(with_key("read")), INCOMPATIBLE, None),
    "a greater key": (document(with_key("read")), document(with_key("admin")), INCOMPATIBLE, None),
    "a parameter": (document(), document(with_parameter()), ADDITION, INCOMPATIBLE),
    "a required one": (document(), document(with_parameter(required=True)), INCOMPATIBLE, INCOMPATIBLE),
    "required now": (
        *(document(with_parameter()), document(with_parameter(required=True))),
        *(INCOMPATIBLE, ADDITION),
    ),
    "a parameter's bound": (
        *(document(with_parameter()), document(with_parameter(schema=COUNT | {"maximum": 200}))),
        *(INCOMPATIBLE, ADDITION),
    ),
    "a list in one value": (listed(), listed(explode=False), INCOMPATIBLE, INCOMPATIBLE),
    "a list by spaces": (listed(), listed(style="spaceDelimited"), INCOMPATIBLE, INCOMPATIBLE),
    "a list as it was": (listed(), listed(style="form", explode=True), None, None),
    "a list of a header": (
        *(listed(**{"in": "header"}), listed(**{"in": "header"}, style="simple", explode=False)),
        *(None, None),
    ),
    "lists by bars": (
        *(listed(style="pipeDelimited"), listed(style="pipeDelimited", explode=True)),
        *(INCOMPATIBLE, INCOMPATIBLE),
    ),
    "one value, or a list": (
        *(document(with_parameter(schema=either(COUNT, {"type": "array"}), explode=each)) for each in (True, False)),
        *(INCOMPATIBLE, INCOMPATIBLE),
    ),
    "one value": (document(with_parameter()), document(with_parameter(explode=False)), None, None),
    "a body": (document(), document(asking(TEXT)), INCOMPATIBLE, INCOMPATIBLE),
    "an optional body": (document(), document(asking(TEXT, required=False)), ADDITION, INCOMPATIBLE),
    "a body is required": (document(asking(TEXT, required=False)), document(asking(TEXT)), INCOMPATIBLE, ADDITION),
    "a media type": (
        *(document(answering(TEXT)), document({"responses": {"201": {"content": {"text/csv": {}}}}})),
        *(INCOMPATIBLE, INCOMPATIBLE),
    ),
    "a status": (document(), document({"responses": {"201": {}, "404": {}}}), ADDITION, INCOMPATIBLE),
    "a status of success": (answered_with("201"), answered_with("201", "204"), INCOMPATIBLE, INCOMPATIBLE),
    "a status elsewhere": (answered_with("201"), answered_with("201", "303"), INCOMPATIBLE, INCOMPATIBLE),
    "a status of any kind": (answered_with("201"), answered_with("201", "default"), INCOMPATIBLE, INCOMPATIBLE),
    "a status of a defect": (answered_with("201"), answered_with("201", "5XX"), ADDITION, INCOMPATIBLE),
    "a code": (document(refusing("in-use")), document(refusing("in-use", "built-in")), ADDITION, INCOMPATIBLE),
    "a header": (document(), document(HEADED), ADDITION, INCOMPATIBLE),
    "a header that may be missing": (document(HEADED), document(SOMETIMES_HEADED), INCOMPATIBLE, None),
    "an event": (
        *(document(answering({})), document(answering({}, **{"x-event-data": {"job": TEXT}}))),
        *(ADDITION, INCOMPATIBLE),
    ),
    "an event's data": (
        *(document(answering({}, **{"x-event-data": {"job": kind}})) for kind in (TEXT, COUNT)),
        *(INCOMPATIBLE, INCOMPATIBLE),
    ),
    "words": (document(), document({"summary": "Make a log", "description": "Of wood."}), None, None),
}


def worst(old, new):
    return max((change.kind for change in compare(old, new)), default=None)


@pytest.mark.parametrize("name", SCHEMAS)
def test_a_schema_that_changes_is_judged_by_its_side(name):
    before, after, forward, back = SCHEMAS[name]
    for old, new, (asked, answered) in ((before, after, forward), (after, before, back)):
        assert worst(document(asking(old)), document(asking(new))) is asked
        assert worst(document(answering(old)), document(answering(new))) is answered
        inner = [document(answering({"$ref": "#/components/schemas/A"}), types={"A": each}) for each in (old, new)]
        assert worst(*inner) is answered
        assert worst(document(asking(an_object(a=old))), document(asking(an_object(a=new)))) is asked


@pytest.mark.parametrize("name", DOCUMENTS)
def test_a_document_that_changes_is_judged(name):
    before, after, forward, back = DOCUMENTS[name]
    assert (worst(before, after), worst(after, before)) == (forward, back)


def test_a_type_that_holds_itself_is_compared_once():
    def tree(leaf):
        branch = {"type": "array", "items": {"$ref": "#/components/schemas/Tree"}}
        types = {"Tree": an_object(branches=branch, leaf=leaf)}
        return document(answering({"$ref": "#/components/schemas/Tree"}), types=types)

    [change] = compare(tree(TEXT), tree(COUNT))
    assert change.pointer == "/components/schemas/Tree/properties/leaf/type"
    assert change.what == 'type from "string" to "integer", in answers'


@pytest.mark.parametrize(
    ("released", "none", "addition", "incompatible"),
    [("0.1.7", "0.1.7", "0.2.0", "0.2.0"), ("1.2.3", "1.2.3", "1.3.0", "2.0.0")],
)
def test_the_version_that_changes_need(released, none, addition, incompatible):
    more = compare(document(), document(with_parameter()))
    less = compare(document(with_parameter()), document())
    assert [needed_version(released, changes) for changes in ([], more, less)] == [none, addition, incompatible]


def test_a_change_without_a_raise_is_explained():
    released, today = document(with_parameter()), document()
    today["info"]["version"] = "1.9.0"
    fault = fault_of_version(released, today)
    assert fault.startswith("The version of the contract is 1.9.0, and must be 2.0.0 or later.")
    assert "incompatible: /paths/~1logs/post/parameters/0: the query parameter limit is gone" in fault
    assert "`make openapi clients`" in fault
    today["info"]["version"] = "2.0.0"
    assert fault_of_version(released, today) is None


@pytest.fixture(scope="module")
def contract():
    return json.loads((ROOT / "openapi/openapi.json").read_text())


@pytest.fixture(scope="module")
def released():
    return json.loads((ROOT / "openapi/released.json").read_text())


def test_the_contract_s_version_is_raised_as_its_changes_need(contract, released):
    fault = fault_of_version(released, contract)
    assert fault is None, fault


@pytest.mark.slow
def test_a_record_without_words_compares_as_the_whole_document(contract):
    record = without_words(contract)
    assert compare(record, contract) == compare(contract, record) == []
    spoilt = deepcopy(contract)
    del spoilt["components"]["schemas"]["Scan"]["properties"]["state"]
    assert compare(record, spoilt) == compare(contract, spoilt)
    assert "the field state is gone, in answers" in {change.what for change in compare(record, spoilt)}


def test_one_version_stands_everywhere(contract):
    newest, _ = HEADINGS.findall((ROOT / "CHANGELOG.md").read_text())[0]
    assert newest == VERSION, "the first heading of CHANGELOG.md is that of another version"
    assert contract["info"]["version"] == VERSION, "stale: run `make openapi`"
    images = yaml.safe_load((ROOT / "docker-compose.yml").read_text())["services"].values()
    ours = {service["image"] for service in images if service["image"].startswith("sawmill-calibration")}
    assert ours == {f"sawmill-calibration:{VERSION}"}


def test_the_record_is_of_the_last_release(released):
    dated = [version for version, day in HEADINGS.findall((ROOT / "CHANGELOG.md").read_text()) if day != "unreleased"]
    assert released["info"]["version"] == dated[0], (
        f"CHANGELOG.md dates {dated[0]}, and openapi/released.json is of another release: run `make release-contract`"
    )


@pytest.mark.slow
def test_a_release_is_recorded_by_one_command(tmp_path, contract):
    for part in (*(ROOT / "openapi").glob("*.py"), ROOT / "openapi/openapi.json", ROOT / "openapi/released.json"):
        (tmp_path / part.name).write_bytes(part.read_bytes())
    command = [sys.executable, tmp_path / "contract_changes.py"]
    shown = subprocess.run(command, check=True, capture_output=True, text=True)
    assert shown.stderr == f"{VERSION} is a version for this.\n"
    subprocess.run([*command, "--release"], check=True, capture_output=True)
    recorded = json.loads((tmp_path / "released.json").read_text())
    assert recorded == without_words(contract)
    # From now on the same version may not change.
    later = deepcopy(contract)
    later["paths"].pop("/v1/scans")
    (tmp_path / "openapi.json").write_text(json.dumps(later))
    refused = subprocess.run([*command, "--release"], check=False, capture_output=True, text=True)
    assert refused.returncode == 1
    assert "the path /v1/scans is gone" in refused.stderr
    assert json.loads((tmp_path / "released.json").read_text()) == recorded
