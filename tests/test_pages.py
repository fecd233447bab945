"""The pages hold together: links and anchors resolve, tables name what is there, lines are short."""

import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from generate import PAGES as GENERATED

from sawmill_service.pages.frame.languages import catalogue
from sawmill_vocabulary.version import PACKAGES

ROOT = Path(__file__).parents[1]
PAGES = [*sorted(ROOT.glob("*.md")), *sorted((ROOT / "docs").rglob("*.md"))]
# Only numbers with a fraction: others may be names and colours.
NUMBER = re.compile(r"(-?\d+\.\d+)")
ID = re.compile(r"\b[mp][0-9a-f]{10}\b")
SOURCES = ("service", "worker", "tests", "benchmarks", "examples")


def named(path: Path) -> str:
    return str(path.relative_to(ROOT))


def prose(text: str) -> str:
    return re.sub(r"^```.*?^```$", "", text, flags=re.MULTILINE | re.DOTALL)


def anchors(page: Path) -> set[str]:
    """What a link into a page may name: its headings as GitHub writes them."""
    headings = re.findall(r"^#+ (.+)$", prose(page.read_text()), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


def leads_somewhere(page: Path, anchor: str) -> bool:
    return page.exists() and (not anchor or anchor in anchors(page))


def source_files() -> list[Path]:
    found = [path for folder in SOURCES for path in (ROOT / folder).rglob("*") if path.suffix in {".py", ".md", ".sh"}]
    return [*found, ROOT / "Makefile", ROOT / "pyproject.toml", ROOT / "docker-compose.yml"]


@pytest.mark.parametrize("page", PAGES, ids=named)
def test_links_lead_to_files_and_headings(page):
    links = re.findall(r"\]\((?!https?:)([^)#\s]*)(?:#([^)\s]+))?\)", prose(page.read_text()))
    assert not [each for each in links if not leads_somewhere((page.parent / each[0]) if each[0] else page, each[1])]


@pytest.mark.parametrize(("page", "lines"), [("README.md", 70), ("docs/understand/architecture.md", 150)])
def test_a_page_is_read_in_one_minute_or_in_ten(page, lines):
    assert len((ROOT / page).read_text().splitlines()) <= lines


def test_a_release_is_read_in_two_minutes():
    _, *releases = re.split(r"^## ", (ROOT / "CHANGELOG.md").read_text(), flags=re.MULTILINE)
    assert max(len(release.strip().splitlines()) for release in releases) <= 40


def test_the_technician_s_words_are_those_of_the_pages():
    # What a document prints in bold stands on a page.
    documents = ((ROOT / f"docs/do/technician{kind}.md").read_text() for kind in ("", ".fi"))
    bold = (re.findall(r"\*\*(.+?)\*\*", document, re.DOTALL) for document in documents)
    english, finnish = ({" ".join(words.split()) for words in each} for each in bold)
    translated = {message.id: message.string for message in catalogue("fi") if message.id}
    assert english <= translated.keys()
    assert {translated[words] for words in english} <= finnish


PICTURES = ROOT / "docs/pictures"
# It has one module for each thing that can be asked for, as people look them up.
FLAT = "worker/sawmill_contracts"
LARGEST_FOLDER = 24
LARGEST_PICTURE_BYTES = 150_000


def test_pictures_are_small_and_shown():
    shown = {name for page in PAGES for name in re.findall(r"pictures/([\w./-]+)\)", page.read_text())}
    pictures = [path for path in PICTURES.rglob("*") if path.is_file()]
    assert {str(path.relative_to(PICTURES)) for path in pictures} <= shown
    assert not [path.name for path in pictures if path.stat().st_size > LARGEST_PICTURE_BYTES]


def test_references_from_code_lead_to_files_and_headings():
    for path in source_files():
        links = re.findall(r"\b(docs/[\w/-]+\.md)(?:#([\w-]+))?", path.read_text())
        assert not [link for link in links if not leads_somewhere(ROOT / link[0], link[1])], named(path)


def test_every_package_has_its_layer():
    assert {path.parent.name for path in ROOT.glob("*/sawmill_*/__init__.py")} == set(PACKAGES)


# Names in the pages for contributors of files that a change makes, or that are no part of the repository.
NEW_FILES = re.compile(r"level|my_|NAME\.json|\.venv/|^worker\.py$")


def test_files_that_the_pages_for_contributors_name_exist():
    listed = ["git", "ls-files", "--cached", "--others", "--exclude-standard"]
    files = subprocess.run(listed, cwd=ROOT, capture_output=True, text=True, check=True).stdout.split()
    understand = ROOT / "docs/understand"
    pages = [ROOT / "CONTRIBUTING.md", understand / "architecture.md", understand / "adding.md"]
    text = "\n".join(page.read_text() for page in [*pages, *sorted((understand / "decisions").glob("*.md"))])
    names = set(re.findall(r"`(?:service:)?([\w./-]+\.(?:py|md|toml|po|html|txt|json))`", text))
    paths = [f"/{file}" for file in files]
    missing = [name for name in names if not any(path.endswith(f"/{name}") for path in paths)]
    assert not [name for name in missing if not NEW_FILES.search(name)]


def test_no_folder_of_the_science_and_the_services_is_a_heap():
    """Some twenty modules at most, so that a reader sees at once where a thing is."""
    folders = {path.parent for root in ("service", "worker") for path in (ROOT / root).rglob("*.py")}
    sizes = {named(folder): len(list(folder.glob("[!_]*.py"))) for folder in folders}
    heaps = {folder: size for folder, size in sizes.items() if size > LARGEST_FOLDER and folder != FLAT}
    assert not heaps, "divide these"


OF_SCANNERS = ("handedness", "phantom-mounting", "phantom-outline", "phantom", "scanner-numbers", "scanner")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("script", "names"),
    [
        ("geometry_drawing.py", ["geometry.svg", "ray-error.svg"]),
        ("scanner_drawings.py", [f"{name}.svg" for name in OF_SCANNERS]),
    ],
)
def test_the_drawings_are_those_of_the_code(tmp_path, script, names):
    subprocess.run([sys.executable, ROOT / "docs/tools" / script, tmp_path], check=True)
    assert sorted(path.name for path in tmp_path.iterdir()) == names
    for name in names:
        # The last digit of a coordinate, a millionth of a point, depends on the processor; ids are sums of coordinates.
        texts = (ID.sub("id", (folder / name).read_text()) for folder in (tmp_path, PICTURES))
        drawn, stored = map(NUMBER.split, texts)
        assert drawn[::2] == stored[::2]
        np.testing.assert_allclose(np.array(drawn[1::2], float), np.array(stored[1::2], float), rtol=0.0, atol=1e-5)


def test_the_glossary_has_every_term_once_in_the_order_of_its_table():
    tables = [
        [[cell.strip() for cell in row.split("|")[1:-1]] for row in table.splitlines()[2:]]
        for table in re.findall(r"^(?:\|.*\n)+", (ROOT / "docs/look-up/glossary.md").read_text(), re.MULTILINE)
    ]
    terms = [[term for term, *_ in table] for table in tables]
    assert all(table == sorted(table, key=str.lower) for table in terms)
    once = [term for table in terms for term in table]
    assert len(once) == len(set(once))
    meanings = [row[-1] for table in tables for row in table]
    assert all(meaning.endswith(".") and not re.search(r"\. [A-Z]", meaning) for meaning in meanings)


LONGEST_LINE = 120


@pytest.mark.parametrize("page", PAGES, ids=named)
def test_lines_are_short_outside_tables_and_code(page):
    lines = [line for line in prose(page.read_text()).splitlines() if not line.startswith("|")]
    without_addresses = (re.sub(r"https?://\S+|\]\([^)]*\)|<!-- figure .*?<!-- end -->", "", line) for line in lines)
    assert not [line for line in without_addresses if len(line) > LONGEST_LINE]


# Words of one team that gave way to the field's (docs/look-up/glossary.md). "Told apart" and "told from" are plain
# English.
PRIVATE = (
    r"rehears\w*|foretell\w*|foretold|look[-_ ]?alikes?|kept[-_ ]back|keeps?[-_ ]back|held[-_ ]out|holding[-_ ]out"
    r"|try[-_ ]out|widely|made[-_ ]up[-_ ]scan|looks at drift|scansaid|abreast|valleys?|what came of|so many"
    r"|told(?! (?:apart|from))"
)
PRIVATE_ON_PAGES = rf"{PRIVATE}|stray|by how much"


def private_words(path: Path, words: str) -> list[str]:
    return [f"{named(path)}: {match[0]}" for match in re.finditer(rf"\b(?:{words})\b", path.read_text(), re.IGNORECASE)]


def test_no_private_words_come_back_and_code_refers_to_pages_of_the_repository():
    files = [path for path in source_files() if path != Path(__file__)]
    assert not [named(path) for path in files if re.search(r"DESIGN section|design page", path.read_text())]
    found = [word for path in files for word in private_words(path, PRIVATE)]
    # The generated ones have the code's words.
    pages = [path for path in PAGES if str(path.relative_to(ROOT)) not in {f"docs/{name}" for name in GENERATED}]
    assert not found + [word for path in pages for word in private_words(path, PRIVATE_ON_PAGES)]
