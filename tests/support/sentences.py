"""What the sources say to their readers: docstrings, comments, and the descriptions of the public document."""

import ast
import io
import re
import tokenize
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

ROOT = Path(__file__).parents[2]
PRODUCT = ("service", "worker")
# A sentence that begins so refers to something that is not there.
OPENING = re.compile(
    r"(?:Of|As|By|With|Without|Those|That|This|These|Where|What|Whatever|Whom|Whose|Which|Who|How|When|Whether|If|From|"
    r"For|At|In|On|To|Into|Out|It|Its|They|Them|He|She|One|Others|Each|Every|All|Both|Some|None|Nothing|Any|Such|And|Or|"
    r"But|Also|Beside|Behind|Below|Above|Among|Between|Until|Since|Before|After|Through|Once|While)\b",
    re.IGNORECASE,
)
# A description of the public document may be a noun phrase, but no fragment of a sentence.
FRAGMENT = re.compile(r"(?:Of|As|By|With|Those|That|Where|What|Whom|From|For)\b", re.IGNORECASE)
PRIVATE = re.compile(
    r"\b(?:anew|whoever|beside|meanwhile|heard|unheard|begun|amid|those of|that of|of its|stands?|look(?:ed)? at|"
    r"goes on|asked for)\b",
    re.IGNORECASE,
)


class Text(NamedTuple):
    """A docstring or a comment, and where it is."""

    place: str
    text: str


def sources() -> list[Path]:
    paths = sorted(path for folder in PRODUCT for path in Path(ROOT, folder).rglob("*.py"))
    return [path for path in paths if "migrations" not in path.parts]


def docstrings(path: Path) -> Iterator[Text]:
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            text = ast.get_docstring(node)
            if text:
                yield Text(f"{path.relative_to(ROOT)}:{getattr(node, 'lineno', 1)}", text)


def comments(path: Path) -> Iterator[Text]:
    """Find the comments, directives of tools left out."""
    for token in tokenize.generate_tokens(io.StringIO(path.read_text()).readline):
        text = token.string.lstrip("# ")
        if token.type == tokenize.COMMENT and not re.match(r"noqa|type:|!|mypy:|fmt:|ruff:", text):
            yield Text(f"{path.relative_to(ROOT)}:{token.start[0]}", text)


def descriptions(document: Any) -> Iterator[Text]:
    """Find the descriptions of the public document, by their path in it."""

    def walk(node: Any, place: str) -> Iterator[Text]:
        if isinstance(node, dict):
            for name, value in node.items():
                if name in {"description", "summary"} and isinstance(value, str):
                    yield Text(place, value)
                elif name not in {"example", "examples"}:
                    yield from walk(value, f"{place}/{name}")
        elif isinstance(node, list):
            for number, value in enumerate(node):
                yield from walk(value, f"{place}/{number}")

    yield from walk(document, "")
