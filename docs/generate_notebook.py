"""docs/start/first-notebook.md and its pictures: examples/calibrate-and-reconstruct.ipynb with its outputs."""

import base64
import json
import re
from html import unescape
from pathlib import Path
from typing import Any

NOTEBOOK = Path(__file__).resolve().parents[1] / "examples/calibrate-and-reconstruct.ipynb"
OPENING = f"""This page is [{NOTEBOOK.name}](../../examples/{NOTEBOOK.name}) with its outputs.
To run it, install Jupyter next to the product and open the file. `make notebooks` writes this page."""


def _notebook() -> list[dict[str, Any]]:
    cells: list[dict[str, Any]] = json.loads(NOTEBOOK.read_text())["cells"]
    return cells


def pictures() -> dict[str, bytes]:
    """Return each picture among the notebook's outputs, by its path in docs/."""
    drawn = [
        output["data"]["image/png"]
        for cell in _notebook()
        for output in cell.get("outputs", [])
        if "image/png" in output.get("data", {})
    ]
    return {f"pictures/notebook-{number}.png": base64.b64decode(png) for number, png in enumerate(drawn, 1)}


def notebook_page() -> str:
    """Return the notebook as a page: texts, code, and outputs below the code."""
    parts, names = [], iter(pictures())
    for cell in _notebook():
        source = "".join(cell["source"])
        if cell["cell_type"] == "markdown":
            parts.append(source.replace("](../docs/", "](../"))
            continue
        parts.append(f"```python\n{source}\n```")
        for output in cell["outputs"]:
            data = output.get("data", {})
            if "image/png" in data:
                parts.append(f"![Output of `{source.splitlines()[-1]}`](../{next(names)})")
            elif "text/html" in data:
                parts.append(html_as_markdown("".join(data["text/html"])))
            else:
                text = "".join(output.get("text") or data["text/plain"])
                parts.append(f"```text\n{text.rstrip()}\n```")
    title, *rest = parts
    heading, _, opening = title.partition("\n\n")
    return "\n\n".join([heading, OPENING, opening, *rest]) + "\n"


def html_as_markdown(html: str) -> str:
    """Return a result's title, sentences and table as Markdown; its embedded picture is left out."""
    title = re.search(r"<p><strong>(.*?)</strong>(?:: <em>(.*?)</em>)?</p>", html)
    if title is None:
        raise ValueError("an output in HTML has no title")
    heading = f"**{unescape(title[1])}**" + (f": {unescape(title[2])}" if title[2] else "")
    sentences = [f"- {unescape(sentence)}" for sentence in re.findall(r"<li>(.*?)</li>", html)]
    rows = re.findall(r"<tr><th[^>]*>(.*?)</th><td[^>]*>(.*?)</td></tr>", html)
    table = "\n".join(
        ["| | |", "|---|---|", *(f"| {unescape(label).strip()} | {unescape(value)} |" for label, value in rows)]
    )
    return "\n\n".join(filter(None, [heading, "\n".join(sentences), table]))
