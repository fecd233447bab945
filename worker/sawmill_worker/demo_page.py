"""The page that the demo writes: the results beside the truth, with pictures."""

from dataclasses import dataclass, field
from pathlib import Path

from sawmill_worker.templating import templates_of

TEMPLATES = templates_of("sawmill_worker")


@dataclass
class Section:
    """One scan: rows of a table under `head`, facts (label, value), pictures (file, caption), files (name, content)."""

    title: str
    text: str
    head: tuple[str, ...]
    rows: list[tuple[str, ...]] = field(default_factory=list)
    facts: list[tuple[str, str]] = field(default_factory=list)
    pictures: list[tuple[str, str]] = field(default_factory=list)
    files: list[tuple[str, str]] = field(default_factory=list)


def write_page(path: Path, sections: list[Section]) -> None:
    """Write index.html; every file that it names lies beside it."""
    path.write_text(TEMPLATES.get_template("demo.html").render(sections=sections), encoding="utf-8")
