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
TEXT, COUNT = {"type": "string"}, {"type": "integer"}


def an_object(required=(), **properties):
    return {"type": "object", "properties": properties, "required": list(required), "additionalProperties": False}


def kind_of(name, **properties):
    return an_object(["kind"], kind={"const": name}, **properties)


def either(*schemas):
    return {"anyOf": list(schemas)}


def one_of(*values):
    return {"type": "string", "enum": list(values)}


def pair_of(*schemas):
    return {"type": "array", "prefixItems": list(schemas)}


RULE = {"dependentSchemas": {"a": {"required": ["b"]}}}
# What changed -> a schema before and after; what it is where a request has it, and where an answer has it; what it is
# the other way round: an addition, incompatible, or nothing.
SIGNS = {"+": Kind.ADDITION, "!": Kind.INCOMPATIBLE, ".": None}
SCHEMAS = {
    "a field more": (an_object(), an_object(a=TEXT), "++", "!!"),
    "a required field more": (an_object(), an_object("a", a=TEXT), "!+", "!!"),
    "required": (an_object(a=TEXT), an_object("a", a=TEXT), "!+", "+!"),
    "another type": (TEXT, COUNT, "!!", "!!"),
    "whole numbers": ({"type": "number"}, COUNT, "!+", "+!"),
    "null": (TEXT, either(TEXT, {"type": "null"}), "+!", "!+"),
    "null in a list of types": (TEXT, {"type": ["string", "null"]}, "+!", "!+"),
    "a word more": (one_of("a"), one_of("a", "b"), "+!", "!+"),
    "words": (TEXT, one_of("a"), "!+", "+!"),
    "one word": (one_of("a", "b"), {"type": "string", "const": "a"}, "!+", "+!"),
    "a kind more": (either(kind_of("disc")), either(kind_of("polygon", a=TEXT), kind_of("disc")), "+!", "!+"),
    "least": (COUNT, COUNT | {"minimum": 1}, "!+", "++"),
    "more than": (COUNT | {"minimum": 1}, COUNT | {"exclusiveMinimum": 1}, "!+", "++"),
    "most": (COUNT | {"maximum": 9}, COUNT | {"maximum": 8}, "!+", "++"),
    "longest": (TEXT | {"maxLength": 9}, TEXT | {"maxLength": 8}, "!+", "++"),
    "a pattern": (TEXT, TEXT | {"pattern": "^a"}, "!+", "++"),
    "another pattern": (TEXT | {"pattern": "^b"}, TEXT | {"pattern": "^a"}, "!+", "!+"),
    "a rule between fields": (an_object(a=TEXT), an_object(a=TEXT) | RULE, "!+", "++"),
    "a format": (TEXT, TEXT | {"format": "date-time"}, "!+", "+!"),
    "a default": (COUNT | {"default": 1}, COUNT | {"default": 2}, "!.", "!."),
    "any field": (an_object(), {"type": "object", "properties": {}}, "++", "!+"),
    "items": ({"type": "array", "items": TEXT}, {"type": "array", "items": COUNT}, "!!", "!!"),
    "values by position": (pair_of(TEXT), pair_of(TEXT, TEXT), "!!", "!!"),
    "going out of use": (TEXT, TEXT | {"deprecated": True}, "++", ".."),
    "words for people": (TEXT, TEXT | {"description": "A name.", "examples": ["a"]}, "..", ".."),
    "a field that is called as words are": (an_object(), an_object(title=TEXT), "++", "!!"),
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


def headed(*, required):
    return {"responses": {"201": {"headers": {"Location": {"required": required, "schema": TEXT}}}}}


def telling(data):
    return document(answering({}, **{"x-event-data": {"job": data}}))


MORE, BARS, HEADER = {"/more": {}}, {"style": "pipeDelimited"}, {"in": "header"}
ONE_OR_MANY = either(COUNT, {"type": "array"})
CSV = {"responses": {"201": {"content": {"text/csv": {}}}}}
# What changed -> a document before and after, what it is, and what it is the other way round.
DOCUMENTS = {
    "a path": (document(), document(paths=MORE), "+!"),
    "a method": (document(paths=MORE), document(paths={"/more": {"get": {}}}), "+!"),
    "a type's name": (document(types={"A": TEXT}), document(types={"B": TEXT}), "!!"),
    "a function's name": (document(), document({"operationId": "create"}), "!!"),
    "a module's name": (document(), document({"tags": ["scans"]}), "!!"),
    "out of use": (document(), document({"deprecated": True}), "+."),
    "a key": (document(), document(with_key("read")), "!."),
    "a greater key": (document(with_key("read")), document(with_key("admin")), "!."),
    "a parameter": (document(), document(with_parameter()), "+!"),
    "a required one": (document(), document(with_parameter(required=True)), "!!"),
    "required now": (document(with_parameter()), document(with_parameter(required=True)), "!+"),
    "a bound": (document(with_parameter()), document(with_parameter(schema=COUNT | {"maximum": 200})), "!+"),
    "a list in one value": (listed(), listed(explode=False), "!!"),
    "a list by spaces": (listed(), listed(style="spaceDelimited"), "!!"),
    "a list as it was": (listed(), listed(style="form", explode=True), ".."),
    "a list of a header": (listed(**HEADER), listed(**HEADER, style="simple", explode=False), ".."),
    "lists by bars": (listed(**BARS), listed(**BARS, explode=True), "!!"),
    "one value, or a list": (
        *(document(with_parameter(schema=ONE_OR_MANY, explode=each)) for each in (True, False)),
        "!!",
    ),
    "one value": (document(with_parameter()), document(with_parameter(explode=False)), ".."),
    "a body": (document(), document(asking(TEXT)), "!!"),
    "an optional body": (document(), document(asking(TEXT, required=False)), "+!"),
    "a body is required": (document(asking(TEXT, required=False)), document(asking(TEXT)), "!+"),
    "a media type": (document(answering(TEXT)), document(CSV), "!!"),
    "a status": (document(), answered_with("201", "404"), "+!"),
    "a status of success": (answered_with("201"), answered_with("201", "204"), "!!"),
    "a status elsewhere": (answered_with("201"), answered_with("201", "303"), "!!"),
    "a status of any kind": (answered_with("201"), answered_with("201", "default"), "!!"),
    "a status of a defect": (answered_with("201"), answered_with("201", "5XX"), "+!"),
    "a code": (document(refusing("in-use")), document(refusing("in-use", "built-in")), "+!"),
    "a header": (document(), document(headed(required=True)), "+!"),
    "a header that may be missing": (document(headed(required=True)), document(headed(required=False)), "!."),
    "an event": (document(answering({})), telling(TEXT), "+!"),
    "an event's data": (telling(TEXT), telling(COUNT), "!!"),
    "words": (document(), document({"summary": "Make a log", "description": "Of wood."}), ".."),
}


def worst(old, new):
    return max((change.kind for change in compare(old, new)), default=None)


@pytest.mark.parametrize("name", SCHEMAS)
def test_a_schema_that_changes_is_judged_by_its_side(name):
    before, after, forward, back = SCHEMAS[name]
    for old, new, signs in ((before, after, forward), (after, before, back)):
        asked, answered = (SIGNS[sign] for sign in signs)
        assert worst(document(asking(old)), document(asking(new))) is asked
        assert worst(document(answering(old)), document(answering(new))) is answered
        inner = [document(answering({"$ref": "#/components/schemas/A"}), types={"A": each}) for each in (old, new)]
        assert worst(*inner) is answered
        assert worst(document(asking(an_object(a=old))), document(asking(an_object(a=new)))) is asked


@pytest.mark.parametrize("name", DOCUMENTS)
def test_a_document_that_changes_is_judged(name):
    before, after, signs = DOCUMENTS[name]
    assert [worst(before, after), worst(after, before)] == [SIGNS[sign] for sign in signs]


def test_a_type_that_holds_itself_is_compared_once():
    def tree(leaf):
        branch = {"type": "array", "items": {"$ref": "#/components/schemas/Tree"}}
        types = {"Tree": an_object(branches=branch, leaf=leaf)}
        return document(answering({"$ref": "#/components/schemas/Tree"}), types=types)

    [change] = compare(tree(TEXT), tree(COUNT))
    assert change.pointer == "/components/schemas/Tree/properties/leaf/type"
    assert change.what == 'type from "string" to "integer", in answers'


def test_the_version_that_changes_need_and_why_it_must_be_raised():
    more = compare(document(), document(with_parameter()))
    less = compare(document(with_parameter()), document())
    assert [needed_version("0.1.7", changes) for changes in ([], more, less)] == ["0.1.7", "0.2.0", "0.2.0"]
    assert [needed_version("1.2.3", changes) for changes in ([], more, less)] == ["1.2.3", "1.3.0", "2.0.0"]
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


def test_one_version_stands_everywhere_is_raised_as_its_changes_need_and_the_record_is_of_the_last_release(contract):
    released = json.loads((ROOT / "openapi/released.json").read_text())
    fault = fault_of_version(released, contract)
    assert fault is None, fault
    newest, _ = HEADINGS.findall((ROOT / "CHANGELOG.md").read_text())[0]
    assert newest == VERSION, "the first heading of CHANGELOG.md is that of another version"
    assert contract["info"]["version"] == VERSION, "stale: run `make openapi`"
    images = yaml.safe_load((ROOT / "docker-compose.yml").read_text())["services"].values()
    ours = {service["image"] for service in images if service["image"].startswith("sawmill-calibration")}
    assert ours == {f"sawmill-calibration:{VERSION}"}
    dated = [version for version, day in HEADINGS.findall((ROOT / "CHANGELOG.md").read_text()) if day != "unreleased"]
    assert released["info"]["version"] == dated[0], (
        f"CHANGELOG.md dates {dated[0]}, and openapi/released.json is of another release: run `make release-contract`"
    )


@pytest.mark.slow
def test_a_record_without_words_compares_as_the_whole_document(contract):
    record = without_words(contract)
    assert compare(record, contract) == compare(contract, record) == []
    spoilt = deepcopy(contract)
    del spoilt["components"]["schemas"]["Scan"]["properties"]["state"]
    assert compare(record, spoilt) == compare(contract, spoilt)
    assert "the field state is gone, in answers" in {change.what for change in compare(record, spoilt)}


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
