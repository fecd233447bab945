"""Everything that the console offers to try works on a fresh data folder."""

import json
from pathlib import Path

import pytest
from documented import check_documented
from example_requests import add_what_is_decided, with_file

from sawmill_platform.contracts.keys import KeyAsk, Scope
from sawmill_service.http.document.openapi_document import write

FOLDER = Path(__file__).parents[2] / "openapi"
FILES = sorted((FOLDER / "requests").glob("*.json"))


@pytest.mark.slow
@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_the_committed_example_request_works(seeded, store, path):
    example = json.loads(path.read_text())
    options = {"params": example["query"], "headers": example["headers"]}
    if example["body_file"]:
        offered = seeded.get(example["body_file"])
        assert offered.status_code == 200
        options |= with_file(example, offered.content)
    elif example["media_type"]:
        options["json"] = example["body"]
    add_what_is_decided(store)
    # A fresh data folder holds no key, one that nobody has would guard nothing, and no webhook, nor allows it one.
    key = store.keys.create(KeyAsk(name="example", scope=Scope.READ))
    asked = example["path"].replace("/v1/keys/example", f"/v1/keys/{key.id}")
    answer = seeded.request(example["method"], asked, **options)
    assert answer.status_code < 300, answer.text
    check_documented(answer)


def texts(folder: Path) -> dict[str, str]:
    paths = [folder / "openapi.json", *(folder / "requests").iterdir()]
    return {str(path.relative_to(folder)): path.read_text() for path in paths}


def test_what_is_committed_is_what_the_service_generates(client, tmp_path):
    (tmp_path / "requests").mkdir()
    (tmp_path / "requests/gone.json").write_text("{}")
    write(client.app, tmp_path)
    assert texts(FOLDER) == texts(tmp_path), "stale: run `make openapi`"


def test_each_operation_has_one_example_and_every_required_parameter_too(client):
    operations = [operation for item in client.app.openapi()["paths"].values() for operation in item.values()]
    assert {path.stem for path in FILES} == {operation["operationId"] for operation in operations}
    for path, item in client.app.openapi()["paths"].items():
        for operation in item.values():
            missing = [p["name"] for p in operation.get("parameters", []) if p["required"] and "example" not in p]
            assert not missing, f"{path}: {missing}"
