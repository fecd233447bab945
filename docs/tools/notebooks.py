"""Run the notebooks in examples/ and keep their outputs in them.

    python docs/tools/notebooks.py [NOTEBOOK ...]

Outputs are kept without what differs between two runs or two machines: times, paths and representations of whole
objects. Pictures get a palette, which makes them small. `make docs` then writes
docs/start/first-notebook.md and its pictures.
"""

import argparse
import base64
import io
import re
from itertools import count
from pathlib import Path

import nbformat
from nbclient import NotebookClient
from PIL import Image

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
# Needs data that are not in the repository: `python docs/tools/measured_pictures.py --only notebook` runs it.
MEASURED = EXAMPLES / "measured-disc.ipynb"
LONGEST_CELL_S = 600
PNG, HTML, PLAIN = "image/png", "text/html", "text/plain"
LARGEST_PICTURE_BYTES = 150_000
# Sizes of palettes, from the finest: the first one that makes a picture small enough is used.
PALETTES = (160, 96, 48, 24)
# Run in the kernel before the first cell: the picture of a calibration shows its table without the time, the last row.
WITHOUT_TIMES = """
import sawmill_calibration.pictures.calibration_report as report
report.calibration_table = lambda result, whole=report.calibration_table: whole(result)[:-1]
"""
TIME_ROW = re.compile(r"<tr><th[^>]*>time</th>.*?</tr>\n?")
ABSOLUTE_PATH = re.compile(r"(?<![\w.~$}:/<])/(?:home|root|tmp|usr|var|opt|Users)/\w")


def main() -> None:
    """Run the notebooks that need nothing but the product."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    own = sorted(set(EXAMPLES.glob("*.ipynb")) - {MEASURED})
    parser.add_argument("notebooks", nargs="*", type=Path, default=own, metavar="NOTEBOOK")
    for path in parser.parse_args().notebooks:
        run_and_keep(path)


def run_and_keep(path: Path) -> None:
    """Run a notebook from the first cell to the last and write its outputs into it."""
    notebook = nbformat.read(path, as_version=4)
    client = NotebookClient(notebook, timeout=LONGEST_CELL_S, record_timing=False)
    numbers = count(1)
    with client.setup_kernel(cwd=str(path.parent)):
        client.kc.execute(WITHOUT_TIMES, silent=True, store_history=False)
        for index, cell in enumerate(notebook.cells):
            client.execute_cell(cell, index, execution_count=next(numbers) if cell.cell_type == "code" else None)
    clean(notebook)
    nbformat.write(notebook, path)
    print(f"{path.name}: {path.stat().st_size / 1e3:.0f} kB")


def clean(notebook: nbformat.NotebookNode) -> None:
    """Take out of a notebook's outputs what differs between runs and machines, and make its pictures small."""
    notebook.metadata["language_info"] = {"name": "python"}
    for cell in notebook.cells:
        cell.metadata = {}
        for output in cell.get("outputs", []):
            data = output.get("data", {})
            if HTML in data:
                data[HTML] = TIME_ROW.sub("", data[HTML])
                data.pop(PLAIN, None)
            if PNG in data:
                data[PNG] = with_few_colours(data[PNG])
                data[PLAIN] = "<Figure>"
            for text in (output.get("text", ""), data.get(HTML, "")):
                if match := ABSOLUTE_PATH.search(text):
                    raise ValueError(f"an output has an absolute path: {text[match.start() : match.start() + 80]!r}")


def with_few_colours(png: str) -> str:
    """Write a PNG in base64 again with a palette: a tenth of its bytes."""
    picture = Image.open(io.BytesIO(base64.b64decode(png))).convert("RGB")
    for colours in PALETTES:
        stream = io.BytesIO()
        reduced = picture.quantize(colours, Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE)
        reduced.save(stream, format="png", optimize=True)
        if stream.tell() <= LARGEST_PICTURE_BYTES:
            break
    return base64.b64encode(stream.getvalue()).decode()


if __name__ == "__main__":
    main()
