"""The page of the public names of `sawmill_calibration`, from signatures, docstrings and the contracts of options."""

import inspect
import re
import textwrap
import typing
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass
from enum import StrEnum
from functools import cached_property
from pathlib import Path
from types import MappingProxyType
from typing import Any

from pydantic import BaseModel

import sawmill_calibration
from sawmill_contracts.calibrations import CalibrationOptions
from sawmill_contracts.fixed_pairs import FixedPairsOptions
from sawmill_contracts.reconstructions import ReconstructionOptions

GROUPS = {
    "Read and simulate scans": ("read_scan", "simulate_phantom_scan", "simulate_log_scan", "Scan"),
    "Calibrate": ("calibrate", "read_calibration", "Calibration"),
    "Calibrate a scanner of fixed pairs": (
        *("calibrate_fixed_pairs", "PairedScanner", "FixedPair"),
        *("FixedPairsResult", "CalibratedPair", "BoardPose"),
        *("locate_marks", "LogOnPairs", "LocatedMark", "PairAgreement"),
    ),
    "Reconstruct": ("reconstruct", "Reconstruction"),
    "Check for drift": ("drift", "Drift"),
    "Geometry": ("Scanner", "Theta", "FanBeamGeometry", "FanViews", "read_views"),
    "Phantoms": ("Phantom", "Polygon", "Disc"),
    "Errors": ("InputError",),
}
OPTIONS: Mapping[str, type[BaseModel]] = MappingProxyType(
    {
        "calibrate": CalibrationOptions,
        "calibrate_fixed_pairs": FixedPairsOptions,
        "reconstruct": ReconstructionOptions,
    }
)

INTRODUCTION = """# Python names

The public names of `sawmill_calibration`, made from the code by `make docs`.

Each function does the same as the command of the same name, on arrays in memory and with the same numbers.
[conventions.md](conventions.md) defines axes, signs and units. [first-notebook.md](../start/first-notebook.md) shows a
complete example with its pictures.

```python
import sawmill_calibration as sawmill

scanner = sawmill.Scanner(source_to_cor_mm=859.46, num_detector_pixels=256, detector_pitch_mm=4.5086)
theta = sawmill.Theta(2.55, 714.7, 319.9, 43.7, 0.281)

scan = sawmill.simulate_phantom_scan("l-shape", scanner, theta, views=90, noise=0.01)
calibration = sawmill.calibrate(scan, "l-shape")
print(calibration)  # the verdict, the bound of the ray error, and theta
calibration.save("RESULT.json")
calibration.report("report.html")  # prints on A4

log = sawmill.simulate_log_scan(scanner, theta, views=120, rows=2, row_pitch_mm=50.0)
volume = sawmill.reconstruct(log, calibration, size=128).volume  # (slices, x, y)
print(sawmill.drift(log, sawmill.read_calibration("RESULT.json")).reason)
```

`Scan`, `Calibration`, `Reconstruction` and `Drift` draw themselves in a notebook. Their `plot()` returns a matplotlib
`Figure`. `%matplotlib inline` makes figures visible.

Notebooks: [calibrate-and-reconstruct.ipynb](../../examples/calibrate-and-reconstruct.ipynb),
[drift-and-phantoms.ipynb](../../examples/drift-and-phantoms.ipynb), and
[measured-disc.ipynb](../../examples/measured-disc.ipynb), whose data are not in the repository
([measured.md](../understand/measured.md)).
"""


# Docstrings


@dataclass(frozen=True)
class Entry:
    """A documented parameter, attribute or error."""

    name: str
    kind: str
    text: str


@dataclass(frozen=True)
class Docstring:
    """A docstring in NumPy's style: the first paragraph, the paragraphs after it, and entries by section."""

    summary: str
    more: str
    sections: Mapping[str, Sequence[Entry]]

    @classmethod
    def of(cls, documented: object) -> "Docstring":
        """Read the docstring of a class, a function or a property."""
        heads = re.split(r"^(\w[\w ]*)\n-{3,}\n", inspect.getdoc(documented) or "", flags=re.MULTILINE)
        paragraphs = [" ".join(each.split()) for each in heads[0].strip().split("\n\n")]
        sections = {name: [*_entries(text)] for name, text in zip(heads[1::2], heads[2::2], strict=True)}
        return cls(paragraphs[0], " ".join(paragraphs[1:]), sections)

    def entry(self, name: str) -> Entry | None:
        """Return the entry of a parameter or an attribute, which may share its line with others."""
        entries = (*self.sections.get("Parameters", ()), *self.sections.get("Attributes", ()))
        return next((entry for entry in entries if name in entry.name.split(", ")), None)


def _entries(section: str) -> Iterator[Entry]:
    for part in re.split(r"\n(?=\S)", section.strip("\n")):
        head, *lines = part.split("\n")
        name, _, kind = head.partition(" : ")
        yield Entry(name.strip().lstrip("*"), kind.strip(), " ".join(" ".join(lines).split()))


# The reference


def python_page() -> str:
    """Return the page of the public names."""
    parts = [INTRODUCTION]
    for title, names in GROUPS.items():
        parts.append(f"## {title}\n")
        for name in names:
            public = getattr(sawmill_calibration, name)
            parts += _class(name, public) if inspect.isclass(public) else _function(name, public)
    return "\n".join(parts).rstrip("\n") + "\n"


def _function(name: str, function: Any) -> Iterator[str]:  # noqa: ANN401 - any public function
    docstring = Docstring.of(function)
    yield f"### {name}\n"
    yield f"```\n{signature(name, function)}\n```\n"
    yield f"{_linked(docstring.summary)}\n"
    yield table(("parameter", "default", "meaning"), parameters(function))
    yield _returned(function)
    yield from _raised(docstring)
    if name in OPTIONS:
        yield f"#### Options of {name}\n"
        yield "A wrong option raises `InputError`. The command line has the same options, with hyphens.\n"
        yield table(("option", "values", "default", "meaning"), option_rows(OPTIONS[name]))


def _class(name: str, public: type) -> Iterator[str]:
    docstring = Docstring.of(public)
    yield f"### Class {name}\n"
    if not issubclass(public, ValueError | BaseModel) and name not in {"Calibration", "Reconstruction", "Drift"}:
        yield f"```\n{signature(name, public)}\n```\n"
    yield _paragraph(" ".join(filter(None, (docstring.summary, docstring.more))))
    yield table(("attribute", "meaning"), attributes(public, docstring))
    methods = [*_methods(public)]
    if methods:
        yield table(("method", "meaning"), methods)


def signature(name: str, public: Any) -> str:  # noqa: ANN401 - any public name
    """Return a signature on lines of at most 110 characters, without types, which the table has."""
    whole = inspect.signature(public)
    bare = [_bare(each) for each in whole.parameters.values() if each.name != "kind"]
    if name in {"Polygon", "Disc"}:
        bare = [each for each in bare if each != "*"]
    keyword_only = [
        each for each in whole.parameters.values() if each.kind is each.KEYWORD_ONLY and each.name != "kind"
    ]
    if keyword_only:
        bare.insert(bare.index(_bare(keyword_only[0])), "*")
    lines, line = [], f"{name}("
    for index, each in enumerate(bare):
        piece = each if index == len(bare) - 1 else f"{each}, "
        if len(line) + len(piece) > 110:
            lines.append(line.rstrip())
            line = " " * (len(name) + 1)
        line += piece
    return "\n".join([*lines, f"{line})"])


def _bare(parameter: inspect.Parameter) -> str:
    if parameter.kind is parameter.VAR_KEYWORD:
        return f"**{parameter.name}"
    return parameter.name if parameter.default is parameter.empty else f"{parameter.name}={_default(parameter)}"


def _default(parameter: inspect.Parameter) -> str:
    value = parameter.default
    if callable(value):
        return "None"
    if repr(value).startswith("<factory>"):
        return "()"
    return repr(str(value)) if isinstance(value, StrEnum) else repr(value)


def parameters(function: Any) -> Iterator[tuple[str, str, str]]:  # noqa: ANN401 - any public function
    """Yield name, default and meaning of each parameter.

    Raises
    ------
    LookupError
        A parameter is not documented.
    """
    docstring, hints = Docstring.of(function), typing.get_type_hints(function)
    for parameter in inspect.signature(function).parameters.values():
        if parameter.name in {"self", "cls"}:
            continue
        entry = docstring.entry(parameter.name)
        if entry is None:
            raise LookupError(f"the docstring of {function.__qualname__} has no parameter {parameter.name}")
        meaning = " ".join(filter(None, (f"{entry.kind}." if entry.kind else "", entry.text)))
        values = _words(hints.get(parameter.name))
        if values and f"`{values[0]}`" not in meaning:
            meaning += f" Values: {', '.join(f'`{value}`' for value in values)}."
        required = parameter.default is parameter.empty
        shown = (
            "" if parameter.kind is parameter.VAR_KEYWORD else "required" if required else f"`{_default(parameter)}`"
        )
        stars = "**" if parameter.kind is parameter.VAR_KEYWORD else ""
        yield f"`{stars}{parameter.name}`", shown, _linked(meaning)


def _words(hint: object) -> list[str]:
    """Return the values of an enum in a type."""
    options = typing.get_args(hint) or (hint,)
    enums = [each for each in options if inspect.isclass(each) and issubclass(each, StrEnum)]
    return [str(member) for enum in enums for member in enum]


def _returned(function: Any) -> str:  # noqa: ANN401 - any public function
    returned = typing.get_type_hints(function)["return"].__name__
    return f"Returns: [`{returned}`](#class-{returned.lower()}).\n"


def _raised(docstring: Docstring) -> Iterator[str]:
    for error in docstring.sections.get("Raises", ()):
        yield _paragraph(f"Raises: `{error.name}`. {error.text}")


def option_rows(contract: type[BaseModel], prefix: str = "") -> Iterator[tuple[str, str, str, str]]:
    """Yield name, values, default and meaning of each option, those of a nested model after it."""
    schema = contract.model_json_schema()
    definitions = schema.get("$defs", {})
    for name, field in schema["properties"].items():
        nested = definitions.get(field.get("$ref", "").rpartition("/")[2], {})
        meaning = field.get("description", nested.get("description", ""))
        if field.get("deprecated"):
            meaning = f"Out of use. {meaning}"
        if nested.get("type") == "object":
            yield f"`{prefix}{name}`", "a dictionary with the keys below", "", _linked(meaning)
            model = typing.get_type_hints(contract)[name]
            yield from option_rows(model, prefix=f"{prefix}{name}.")
            continue
        values, default = " or ".join(_values(field, definitions)), f"`{field.get('default')}`"
        yield f"`{prefix}{name}`", values, default, _linked(meaning)


def _values(schema: Mapping[str, Any], definitions: Mapping[str, Any]) -> Iterator[str]:
    """Yield the values that a JSON schema allows, in words."""
    if "anyOf" in schema:
        for each in schema["anyOf"]:
            yield from _values(each, definitions)
    elif "$ref" in schema:
        yield from _values(definitions[schema["$ref"].rpartition("/")[2]], definitions)
    elif "enum" in schema:
        yield ", ".join(f"`{value}`" for value in schema["enum"])
    elif "const" in schema:
        yield f"`{schema['const']}`"
    elif schema["type"] == "array":
        if "prefixItems" in schema:
            yield f"{len(schema['prefixItems'])} numbers"
        else:
            yield f"a list of {' or '.join(_values(schema['items'], definitions))}"
    elif schema["type"] in {"integer", "number"}:
        yield _number(schema)
    elif schema["type"] != "null":
        pattern = re.fullmatch(r"\^\(((?:[\w-]+\|)+).*", schema.get("pattern", ""))
        names = {"string": "a string", "boolean": "`True`, `False`"}
        yield ", ".join(f"`{word}`" for word in pattern[1].strip("|").split("|")) if pattern else names[schema["type"]]


def _number(schema: Mapping[str, Any]) -> str:
    word = "an integer" if schema["type"] == "integer" else "a number"
    bounds = {
        "minimum": "at least",
        "exclusiveMinimum": "above",
        "maximum": "at most",
        "exclusiveMaximum": "below",
    }
    stated = [f"{text} {schema[bound]:.10g}" for bound, text in bounds.items() if bound in schema]
    return ", ".join([word, *stated]) if stated else word


def attributes(public: type, docstring: Docstring) -> Iterator[tuple[str, str]]:
    """Yield name and meaning of each public field and property."""
    described = (
        {each.name: each.metadata.get("description", "") for each in fields(public)} if is_dataclass(public) else {}
    )
    if issubclass(public, BaseModel):
        described = {each: field.description or "" for each, field in public.model_fields.items()}
    names = [name for name in described if name != "kind"]
    names += [entry.name for entry in docstring.sections.get("Attributes", ()) if entry.name not in names]
    for name in names:
        entry = docstring.entry(name)
        kind = f"{entry.kind}. " if entry is not None and entry.kind else ""
        text = described.get(name) or (entry.text if entry is not None else "")
        if not text and name not in public.__annotations__:  # of a base that is not public
            continue
        if not text:
            raise LookupError(f"the docstring of {public.__name__} has no attribute {name}")
        yield f"`{name}`", _linked(kind + text)
    for name, member in vars(public).items():
        if isinstance(member, property | cached_property) and not name.startswith("_"):
            yield f"`{name}`", _linked(Docstring.of(member).summary)


def _methods(public: type) -> Iterator[tuple[str, str]]:
    for name, member in vars(public).items():
        function = inspect.unwrap(getattr(public, name)) if isinstance(member, classmethod) else member
        if name.startswith("_") or (not inspect.isfunction(function) and not inspect.ismethod(function)):
            continue
        docstring = Docstring.of(function)
        called = [_bare(each) for each in inspect.signature(function).parameters.values() if each.name != "self"]
        entries = docstring.sections.get("Parameters", ())
        meaning = docstring.summary + "".join(f" `{entry.name}`: {entry.text}" for entry in entries)
        yield f"`{name}({', '.join(called)})`", _linked(meaning)


def _linked(text: str) -> str:
    """Turn references to pages, as docstrings have them, into links of a page in docs/look-up."""

    def link(reference: re.Match[str]) -> str:
        path, anchor = reference[1], reference[2] or ""
        if path == "look-up/python.md":
            return f"[the table below]({anchor})"
        target = path.removeprefix("look-up/") if path.startswith("look-up/") else f"../{path}"
        return f"[{Path(path).name}]({target}{anchor})"

    return re.sub(r"docs/([\w/-]+\.md)(#[\w-]+)?", link, text)


def _paragraph(text: str) -> str:
    return textwrap.fill(_linked(text), 120, break_long_words=False, break_on_hyphens=False) + "\n"


def table(head: Sequence[str], rows: Iterable[Iterable[str]]) -> str:
    """Return a table of Markdown."""
    lines = [f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in row)} |" for row in (head, *rows)]
    return "\n".join([lines[0], f"|{'---|' * len(head)}", *lines[1:]]) + "\n"
