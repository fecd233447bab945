"""docs/do/connect.md and the programs in examples/clients have the same steps, and the contract's routes and fields."""

import json
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PAGE = (ROOT / "docs/do/connect.md").read_text()
PROGRAMS = sorted((ROOT / "examples/clients").glob("whole_job.*"))
DOCUMENT = json.loads((ROOT / "openapi/openapi.json").read_text())
ROUTES = {re.sub(r"\{\w+\}", "{}", path): methods for path, methods in DOCUMENT["paths"].items()}


def named(path: Path) -> str:
    return path.name


def fields(schema: str) -> set[str]:
    return set(DOCUMENT["components"]["schemas"][schema]["properties"])


@pytest.mark.parametrize("path", PROGRAMS, ids=named)
def test_a_program_has_the_steps_of_the_page(path):
    steps = re.findall(r"^## (Repeats and refusals|\d\. .+)$", PAGE, re.MULTILINE)
    assert len(steps) == 10
    commented = re.findall(r"^ *(?:#|//) (Repeats and refusals|\d\. .+)$", path.read_text(), re.MULTILINE)
    assert commented == steps


def test_the_page_s_routes_are_the_contract_s():
    requests = re.findall(r"`(GET|POST|PUT|PATCH|DELETE) (/[^`?]*)", PAGE)
    assert len(requests) > 10
    assert [each for each in requests if each[0].lower() not in ROUTES.get(re.sub(r"\{\w+\}", "{}", each[1]), {})] == []


@pytest.mark.parametrize("path", [path for path in PROGRAMS if path.suffix != ".py"], ids=named)
def test_a_program_s_paths_are_the_contract_s(path):
    sent = re.findall(r"/v1/[^\"?]*", re.sub(r"\$?\{[^{}]*\}|\$\w+", "x", path.read_text()))
    assert len(sent) > 10
    patterns = [re.sub(r"\{\w+\}", "[^/]+", known) for known in DOCUMENT["paths"]]
    unknown = {each for each in sent if not any(re.fullmatch(pattern, each) for pattern in patterns)}
    assert unknown == set()


def test_the_page_s_answers_have_the_contract_s_fields():
    failure, calibration = (json.loads(text) for text in re.findall(r"```json\n(.*?)```", PAGE, re.DOTALL))
    assert failure.keys() <= fields("Failure")
    assert calibration.keys() <= fields("CalibrationSucceeded")
    assert calibration["predicted_ray_error_mm"].keys() <= fields("PredictedRayError")


def test_the_page_has_every_type_of_a_file_for_generators():
    operations = [operation for methods in DOCUMENT["paths"].values() for operation in methods.values()]
    answers = [answer for operation in operations for answer in operation["responses"].values()]
    types = {kind for answer in answers for kind in answer.get("content", {}) if not kind.startswith("text/")}
    types -= {"application/json", "application/problem+json"}
    [row] = re.findall(r"^\| others \|.*$", PAGE, re.MULTILINE)
    assert set(re.findall(r"`([a-z]+/[\w+-]+)`", row)) == types
