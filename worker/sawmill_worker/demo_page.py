"""The page that the demo leaves behind: what was found, beside the truth, with its pictures."""

from dataclasses import dataclass, field
from html import escape
from pathlib import Path

STYLE = """
body { font: 16px/1.5 system-ui, sans-serif; max-width: 1200px; margin: 2rem auto; padding: 0 1rem; color: #1c1c1c; }
h1, h2 { line-height: 1.2; } h2 { margin-top: 3rem; border-top: 1px solid #ccc; padding-top: 1rem; }
table { border-collapse: collapse; margin: 1rem 0; } th, td { padding: .25rem .9rem; text-align: right; }
th:first-child, td:first-child { text-align: left; } tr:nth-child(even) { background: #f3f3f0; }
figure { margin: 1.5rem 0; } img { max-width: 100%; border: 1px solid #ddd; } figcaption { color: #555; }
a { color: #0b5394; }
"""


@dataclass
class Section:
    """One scan's story: rows of a table (label, cells), pictures (file, caption) and files to take away."""

    title: str
    text: str
    head: tuple[str, ...]
    rows: list[tuple[str, ...]] = field(default_factory=list)
    facts: list[tuple[str, str]] = field(default_factory=list)
    pictures: list[tuple[str, str]] = field(default_factory=list)
    files: list[tuple[str, str]] = field(default_factory=list)


def write_page(path: Path, sections: list[Section]) -> None:
    """Write index.html; everything it shows lies beside it."""
    body = "".join(_section(section) for section in sections)
    path.write_text(
        "<!doctype html><html lang='en'><meta charset='utf-8'><title>Sawmill calibration: demo</title>"
        f"<style>{STYLE}</style><h1>Sawmill calibration: what the demo did</h1>"
        "<p>A scan went to the service over HTTP, was calibrated, and a log was reconstructed with the geometry found. "
        "Every number below was computed in this run.</p>"
        f"{body}</html>\n"
    )


def _section(section: Section) -> str:
    head = "".join(f"<th>{escape(cell)}</th>" for cell in section.head)
    rows = "".join("<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in row) + "</tr>" for row in section.rows)
    facts = "".join(f"<tr><td>{escape(label)}</td><td>{escape(value)}</td></tr>" for label, value in section.facts)
    pictures = "".join(
        f"<figure><img src='{escape(name)}' alt='{escape(caption)}'><figcaption>{escape(caption)}</figcaption></figure>"
        for name, caption in section.pictures
    )
    files = "".join(
        f"<li><a href='{escape(name)}'>{escape(name)}</a>: {escape(what)}</li>" for name, what in section.files
    )
    return (
        f"<h2>{escape(section.title)}</h2><p>{escape(section.text)}</p>"
        f"<table><tr>{head}</tr>{rows}</table><table>{facts}</table>{pictures}<ul>{files}</ul>"
    )
