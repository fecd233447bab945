"""The pages of docs/evidence, from benchmarks/results.

    python docs/tools/evidence.py

`make figures` runs it. A page has a template in benchmarks/evidence: Markdown in which `{NAME.key 2 s}` is a figure, as
in a mark of figures.py. Each section ends with the command, commit, date and machine of the results files that it
shows. Results files that no template shows are on the page `more.md`.
"""

import re
import textwrap

from figures import ROOT, Results, conditions, figure, read_results

TEMPLATES = ROOT / "benchmarks/evidence"
FOLDER = ROOT / "docs/evidence"
PLACE = re.compile(r"\{([\w-]+)\.([\w.-]+)(?: (\d+))?(?: ([^{}]+))?\}")
HEAD = "*Written by `make figures` from `benchmarks/results`.*"
MORE = "more"
LINE = 120
# The first characters of blocks that are no paragraphs: headings, tables, pictures, lists, code.
KEPT = ("#", "|", "!", "- ", "```")


def read_templates() -> dict[str, str]:
    """Read all templates, by the name of the page."""
    return {path.stem: path.read_text() for path in sorted(TEMPLATES.glob("*.md"))}


def pages(templates: dict[str, str], results: Results) -> dict[str, str]:
    """Write all pages, by name.

    Raises
    ------
    LookupError
        A template names a file or a value that does not exist.
    """
    shown = {place[1] for template in templates.values() for place in PLACE.finditer(template)}
    rest = [f"## {name}\n\n{_everything(name, results)}" for name in sorted(results.keys() - shown)]
    more = {MORE: "\n\n".join(["# Other measurements", *rest])} if rest else {}
    return {name: _page(template, results) for name, template in (templates | more).items()}


def _page(template: str, results: Results) -> str:
    first, *sections = re.split(r"^(?=## )", template, flags=re.MULTILINE)
    title, _, text = _filled(first, results).strip().partition("\n")
    parts = [title, text.strip(), HEAD, *(_section(section, results) for section in sections)]
    return "\n\n".join(_wrapped(block) for part in parts if part for block in part.split("\n\n")) + "\n"


def _section(section: str, results: Results) -> str:
    """Fill in the figures, and add how they were measured."""
    names = dict.fromkeys(place[1] for place in PLACE.finditer(section))
    text = _filled(section, results).strip()
    return "\n\n".join([text, *dict.fromkeys(f"*Measured by {conditions(results[name])}.*" for name in names)])


def _filled(text: str, results: Results) -> str:
    return PLACE.sub(lambda place: figure(*place.groups(), results=results).strip(), text)


def _wrapped(block: str) -> str:
    """Break a paragraph into lines; leave other blocks as they are."""
    if block.startswith(KEPT):
        return block
    return textwrap.fill(block, LINE, break_long_words=False, break_on_hyphens=False)


def _everything(name: str, results: Results) -> str:
    """Show a file's tables, and its other values as a list."""
    values = results[name]["values"]
    tables = [f"{{{name}.{key}}}" for key, value in values.items() if "\n" in str(value)]
    others = [key for key, value in values.items() if isinstance(value, int | float | str) and "\n" not in str(value)]
    return "\n\n".join([*tables, "\n".join(f"- `{key}`: {{{name}.{key} 3}}" for key in others)])


def main() -> None:
    """Write all pages, remove those without results, and name what changed."""
    FOLDER.mkdir(exist_ok=True)
    written = pages(read_templates(), read_results())
    for path in FOLDER.glob("*.md"):
        if path.stem not in written:
            path.unlink()
            print(f"{path.relative_to(ROOT)}, removed")
    for name, text in written.items():
        path = FOLDER / f"{name}.md"
        if not path.exists() or path.read_text() != text:
            path.write_text(text)
            print(path.relative_to(ROOT))


if __name__ == "__main__":
    main()
