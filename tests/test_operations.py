"""What the pages for a mill's IT name exists: commands, settings, codes, lines of the log; their steps on data work."""

import json
import re
import shlex
import subprocess
import sys
import tarfile
import tomllib
from pathlib import Path

import pytest
from emptied_databases import ARCHIVE
from page_blocks import KNOWN, blocks, check_options
from typer.testing import CliRunner

from sawmill_command.commands import main

ROOT = Path(__file__).parents[1]
DO = ROOT / "docs/do"
PAGES = [
    *(DO / f"{name}.md" for name in ("install", "containers", "run", "monitor", "backup", "sizing", "troubleshooting")),
    ROOT / "docs/understand/security.md",
]
MISSPELT = {"SAWMILL_WORKER"}
# A service of compose, a command, a folder that a page makes.
NO_NAMES = {"short-worker", "install-service", "sawmill-after", "redis-server"}


def commands(page: Path) -> list[list[str]]:
    """The words behind `sawmill` of each line that calls it, also by its path or within another command."""
    lines = [line for block in blocks(page) for line in block.splitlines()]
    found = (re.search(r"(?:^|.*[\s/])sawmill ([a-z][^|>]*)", line) for line in lines)
    return [shlex.split(match[1]) for match in found if match]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_every_command_option_and_setting_exists(page):
    for words in commands(page):
        check_options(words)
    assert set(re.findall(r"\bSAWMILL_[A-Z_]+[A-Z]", page.read_text())) <= KNOWN | MISSPELT


@pytest.fixture(scope="module")
def sources() -> str:
    files = [path for folder in ("service", "worker") for path in (ROOT / folder).rglob("*.py")]
    files += [*(ROOT / "service/sawmill_service/problem_texts").glob("*.toml"), ROOT / "installation/install.sh"]
    return "\n".join(path.read_text() for path in files)


def test_every_code_and_line_of_the_log_exists(sources):
    for page in PAGES:
        named = set(re.findall(r"`([a-z]+(?:-[a-z]+)+)`", page.read_text()))
        assert {name for name in named - NO_NAMES if f'"{name}"' not in sources} == set(), page.name


def test_what_the_service_says_at_a_start_is_quoted_as_it_is(sources):
    start = DO / "troubleshooting.md"
    [table] = re.findall(r"^## Failed start\n(.*?)^## ", start.read_text(), re.MULTILINE | re.DOTALL)
    symptoms = [row.split("|")[1] for row in table.splitlines() if row.startswith("| ")][1:]
    said = [quote for symptom in symptoms for quote in re.findall(r"`([^`]+ [^`]+)`", symptom)]
    assert len(said) > 5
    plain = re.sub(r"\{[^{}]*\}|\$\w+", "...", sources)
    for quote in said:
        parts = re.split(r"\.\.\.|SAWMILL_WORKER |: |\d[\d.]+", quote)
        missing = [part.strip() for part in parts if part.strip(" `") and part.strip() not in plain]
        # SQLite's own sentence.
        assert not missing or quote == "database disk image is malformed", quote


def test_codes_in_the_headings_of_errors_have_their_status():
    texts = (ROOT / "service/sawmill_service/problem_texts").glob("*.toml")
    problems = [problem for path in texts for problem in tomllib.loads(path.read_text())["problem"]]
    status = {code: one["status"] for one in problems if "status" in one for code in one["codes"]}
    for page in PAGES:
        for number, code in re.findall(r"\b([45]\d\d) `([a-z-]+)`", page.read_text()):
            if code not in {"disk-full", "ready"}:
                assert status[code] == int(number), code


@pytest.mark.slow
def test_keys_and_backups_go_as_the_pages_have_them(tmp_path):
    """The commands of run.md and backup.md on a data folder of 0.1.0, which the backup takes as it is."""
    data, restored, disk = tmp_path / "data", tmp_path / "restored", tmp_path / "usb"
    with tarfile.open(ARCHIVE) as archive:
        archive.extractall(data, filter="data")
    for folder in (restored, disk):
        folder.mkdir(mode=0o700)
    taken = run(["backup", str(disk), "--data", str(data)], status=1)  # its archive leaves files out
    [made] = disk.glob("sawmill-*")
    assert str(made) in taken
    done = set()
    dated = re.compile(r"sawmill-\d{8}T\d{6}Z")
    for words in [words for words in commands(DO / "backup.md") if words[0] in {"backup", "restore"}]:
        line = [dated.sub(made.name, word).replace("/mnt/usb/sawmill", str(disk)) for word in words]
        line = [word.replace("/var/lib/sawmill", str(restored)) for word in line]
        if line[0] == "restore":
            run(line)
            done.add(tuple(word for word in line if word.startswith("--")))
    assert done == {("--check",), ("--data",)}
    # The doctor may be run before the service has started: the restored folder is whole. The archive lacks files.
    report = json.loads(run(["doctor", "--json", "--data", str(restored)], status=1))
    assert {finding["state"] for finding in report["findings"] if finding["subject"] == "data folder"} == {"good"}
    assert run(["migrate", "--data", str(restored)]).endswith("0022.\n")
    made_keys = []
    for words in [words for words in commands(DO / "run.md") if words[0] == "key"]:
        line = [made_keys[0] if word == "KEY_ID" else word for word in words]
        run([*line, "--data", str(restored)])
        made_keys = re.findall(r"^([0-9a-f]{32})", run(["key", "list", "--data", str(restored)]), re.MULTILINE)
    assert len(made_keys) == 2


def run(words: list[str], status: int = 0) -> str:
    done = CliRunner().invoke(main, words)
    assert done.exit_code == status, done.output
    return done.output


def test_a_worker_may_be_limited_to_the_kinds_of_the_page():
    """A fresh process registers the kinds by itself."""
    [kinds] = re.findall(r"`--kinds ([\w,-]+)`", (DO / "run.md").read_text())
    command = [sys.executable, "-m", "sawmill_command.commands", "worker", "--kinds", f"{kinds},paint"]
    refused = subprocess.run(command, capture_output=True, text=True, check=False)
    assert refused.returncode == 2
    assert "'paint' is no kind of job: ingest" in " ".join(refused.stderr.split())


def test_the_picture_of_an_installation_names_what_runs():
    picture = (ROOT / "docs/pictures/deployment.svg").read_text()
    assert "prefers-color-scheme: dark" in picture
    for text in ("sawmill serve", "127.0.0.1:8000", "/var/lib/sawmill", "sawmill.db", "port 443"):
        assert text in picture
