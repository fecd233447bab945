"""Draw docs/pictures/packages.svg, the picture in docs/understand/architecture.md, from the packages' own imports.

    python docs/tools/package_drawing.py [FOLDER]

The layers are pyproject.toml's. A dot says that modules of the row's package import the column's package; a
line of the row is the first sentence of the package's docstring.
"""

import ast
import sys
import tomllib
from html import escape
from pathlib import Path

ROOT = Path(__file__).parents[2]
WIDTH, ROW, TOP, NAMES, DOTS, STEP = 1250, 44, 100, 200, 850, 32


def layers() -> list[list[str]]:
    """Read the layers, the highest first; packages of one layer do not import each other."""
    contracts = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"]["contracts"]
    return [layer.replace(" ", "").split("|") for layer in contracts[0]["layers"]]


def folder_of(package: str) -> Path:
    """Find a package's folder."""
    return next(ROOT / root / package for root in ("service", "worker") if (ROOT / root / package).is_dir())


def imported_by(package: str) -> set[str]:
    """Collect the packages that a package's modules import."""
    found = set()
    for path in folder_of(package).rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            names = [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            names += [each.name for each in node.names] if isinstance(node, ast.Import) else []
            found |= {name.split(".")[0] for name in names}
    return found - {package}


def drawing() -> str:
    """Draw the packages as an SVG."""
    packages = [package for layer in layers() for package in layer]
    parts = []
    for number, package in enumerate(packages):
        x = DOTS + STEP * number + STEP / 2
        parts.append(f'<text x="0" y="0" class="name" transform="translate({x + 4} {TOP - 10}) rotate(-60)">')
        parts.append(f"{package.removeprefix('sawmill_')}</text>")
    for number, package in enumerate(packages):
        y = TOP + ROW * number
        imported = imported_by(package)
        text = ast.get_docstring(ast.parse((folder_of(package) / "__init__.py").read_text())) or ""
        role = text.splitlines()[0].split(". ")[0].rstrip(".")
        root = folder_of(package).parent.name
        parts.append(f'<rect x="10" y="{y}" width="{DOTS - 20}" height="{ROW - 8}" rx="6" class="{root}"/>')
        parts.append(f'<text x="22" y="{y + 23}" class="name">{package}</text>')
        parts.append(f'<text x="{NAMES}" y="{y + 23}" class="role">{escape(role)}</text>')
        for place, other in enumerate(packages):
            x, middle = DOTS + STEP * place + STEP / 2, y + (ROW - 8) / 2
            if other == package:
                parts.append(f'<rect x="{x - 6}" y="{middle - 6}" width="12" height="12" class="itself"/>')
            elif other in imported:
                parts.append(f'<circle cx="{x}" cy="{middle}" r="5" class="import"/>')
            else:
                parts.append(f'<circle cx="{x}" cy="{middle}" r="1" class="none"/>')
    height = TOP + ROW * len(packages) + 10
    style = (
        "text{font-family:sans-serif;font-size:13px;fill:#222}.name{font-weight:bold}.role{fill:#444}"
        ".service{fill:#e3edf7;stroke:#7a9cc0}.worker{fill:#f3ecdd;stroke:#b39a63}"
        ".itself{fill:#888}.import{fill:#2b5d8c}.none{fill:#bbb}"
    )
    head = f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {height}" width="{WIDTH}" height="{height}">'
    back = f'<rect width="{WIDTH}" height="{height}" fill="#fff"/>'
    return "\n".join([head, f"<style>{style}</style>", back, *parts, "</svg>"]) + "\n"


def main() -> None:
    """Write the drawing."""
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else ROOT / "docs/pictures"
    (folder / "packages.svg").write_text(drawing())


if __name__ == "__main__":
    main()
