"""Kinds of problems: every code that the sources name has its page, and no page is of a code that none names."""

import ast
import re
from collections.abc import Iterator
from html import unescape
from pathlib import Path

import pytest
from pydantic import SecretStr

from sawmill_contracts.failure_codes import CODES
from sawmill_contracts.scans import ScanState
from sawmill_platform import errors
from sawmill_platform.contracts.jobs import Failure, FailureKind
from sawmill_service.access import LOGIN
from sawmill_service.app import create_app
from sawmill_service.http.problem_types import problem_types
from sawmill_service.pages.frame.languages import texts
from sawmill_service.settings import ServiceSettings

ROOT = Path(__file__).parents[2]
SOURCES = [*(ROOT / "service").rglob("*.py"), *(ROOT / "worker").rglob("*.py")]
# Where the code stands among the arguments, and how it is made of what stands there.
CODES_AT = {
    "Refused": (1, "{}"),
    "problem_response": (2, "{}"),
    "Busy": (0, "{}"),
    "Conflict": (0, "{}"),
    "Invalid": (0, "{}"),
    "OutOfRange": (0, "{}"),
    "NotStored": (0, "{}"),
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
    for path in SOURCES:
        for node in ast.walk(ast.parse(path.read_text())):
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
    wrong = {"Authorization": "Bearer wrong"}
    assert client.get("/problems/storage-unavailable", headers=wrong).status_code == 200


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
