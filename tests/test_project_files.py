"""The files that a code host reads: citation, workflows, templates, hooks, attributes."""

import re
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

from sawmill_vocabulary.version import VERSION

ROOT = Path(__file__).parents[1]
WORKFLOWS = sorted((ROOT / ".github/workflows").glob("*.yml"))
FORMS = sorted(set((ROOT / ".github/ISSUE_TEMPLATE").glob("*.yml")) - {ROOT / ".github/ISSUE_TEMPLATE/config.yml"})
MAKEFILE = (ROOT / "Makefile").read_text()


@pytest.mark.parametrize(
    ("schema", "files"),
    [
        ("vendor.citation-file-format", [ROOT / "CITATION.cff"]),
        ("vendor.github-workflows", WORKFLOWS),
        ("custom.github-workflows-require-timeout", WORKFLOWS),
        ("vendor.github-issue-forms", FORMS),
        ("vendor.github-issue-config", [ROOT / ".github/ISSUE_TEMPLATE/config.yml"]),
    ],
)
def test_each_file_fits_its_schema(schema, files):
    command = [sys.executable, "-m", "check_jsonschema", "--builtin-schema", schema, *files]
    checked = subprocess.run(command, capture_output=True, text=True, check=False)
    assert checked.returncode == 0, checked.stdout


def test_the_citation_names_this_version_and_the_paper():
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    assert citation["version"] == VERSION
    paper = citation["preferred-citation"]
    authors = ["Senchukova", "Suuronen", "Heikkinen", "Roininen"]
    assert [author["family-names"] for author in paper["authors"]] == authors
    assert paper["identifiers"][0]["value"] == "arXiv:2206.14444"


def test_workflows_use_two_actions_and_commands_that_exist():
    jobs = [job for workflow in WORKFLOWS for job in yaml.safe_load(workflow.read_text())["jobs"].values()]
    used = [step for job in jobs for step in job["steps"]]
    actions = {step["uses"].split("@")[0] for step in used if "uses" in step}
    assert actions == {"actions/checkout", "actions/setup-python"}
    commands = "\n".join(step.get("run", "") for step in used)
    targets = set(re.findall(r"^([a-z-]+):", MAKEFILE, re.MULTILINE))
    assert {"image", "pins"} <= set(re.findall(r"^make ([a-z-]+)", commands, re.MULTILINE)) <= targets
    assert ".ci/run" in commands


def test_the_hooks_before_a_commit_run_what_make_lint_runs():
    [repository] = yaml.safe_load((ROOT / ".pre-commit-config.yaml").read_text())["repos"]
    assert repository["repo"] == "local"
    hooks = {tuple(hook["entry"].removeprefix(".venv/bin/").split()) for hook in repository["hooks"]}
    _, rest = MAKEFILE.split("\nlint: install-dev\n")
    commands = re.findall(r"^\t@\$\(BIN\)/(.+)$", rest.split("\n\n")[0], re.MULTILINE)
    # pre-commit names the files, the Makefile takes the whole folder.
    assert {tuple(command.replace(" .", "").split()) for command in commands} == {
        tuple(word for word in hook if word != "--force-exclude") for hook in hooks
    }


def test_tests_that_contributors_are_named_and_files_with_attributes_exist():
    named = re.findall(r"pytest (tests/\S+\.py)(?: -k (\w+))?", (ROOT / "CONTRIBUTING.md").read_text())
    assert named
    for file, word in named:
        assert re.search(rf"^def test_\w*{word}", (ROOT / file).read_text(), re.MULTILINE)
    patterns = re.findall(r"^([\w./*-]+) ", (ROOT / ".gitattributes").read_text(), re.MULTILINE)
    assert not [pattern for pattern in patterns if not any(ROOT.glob(pattern if "/" in pattern else f"**/{pattern}"))]
