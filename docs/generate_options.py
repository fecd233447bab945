"""The types of the options of `calibrate` and `reconstruct`, from their contracts, for type checkers and editors."""

import textwrap
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter

from sawmill_contracts.calibrations import CalibrationOptions
from sawmill_contracts.reconstructions import ReconstructionOptions

OPTION_TYPES = Path(__file__).parents[1] / "worker/sawmill_calibration/option_types.py"
HEAD = '''"""Options of `calibrate` and `reconstruct`, written by `make docs` from their contracts."""

from collections.abc import Sequence
from typing import Literal, TypedDict

# ruff: noqa: UP013 - short

'''
INDENT, WIDTH, UNBROKEN = " " * 4, 118, "\xa0"
PLAIN = {"string": "str", "integer": "int", "number": "float", "boolean": "bool", "null": "None"}


def option_types() -> str:
    """Return the module with a typed dictionary for each function that takes options."""
    schemas = {of.__name__: TypeAdapter(of).json_schema() for of in (CalibrationOptions, ReconstructionOptions)}
    shared = {name: schema for each in schemas.values() for name, schema in each.pop("$defs").items()}
    lines = [_literal(name, schema["enum"]) for name, schema in sorted(shared.items()) if "enum" in schema]
    objects = {name: schema for name, schema in (shared | schemas).items() if "enum" not in schema}
    lines += [_dictionary(name, schema["properties"]) for name, schema in objects.items()]
    return HEAD + "".join(lines)


def _literal(name: str, values: list[str]) -> str:
    line = f"{name} = Literal[{', '.join(map(chr(34).__add__, (f'{value}{chr(34)}' for value in values)))}]"
    if len(line) <= WIDTH:
        return f"{line}\n"
    return f"{name} = Literal[\n{_wrapped(line.partition('[')[2][:-1], INDENT)},\n]\n"


def _dictionary(name: str, properties: dict[str, Any]) -> str:
    options = (f'"{option}": {_annotation(each)}'.replace(" ", UNBROKEN) for option, each in properties.items())
    body = _wrapped(", ".join(options), 2 * INDENT).replace(UNBROKEN, " ")
    return f'{name} = TypedDict(\n{INDENT}"{name}",\n{INDENT}{{\n{body},\n{INDENT}}},\n{INDENT}total=False,\n)\n'


def _wrapped(words: str, indent: str) -> str:
    return textwrap.fill(words, WIDTH, initial_indent=indent, subsequent_indent=indent, break_on_hyphens=False)


def _annotation(schema: dict[str, Any]) -> str:
    if "anyOf" in schema:
        return " | ".join(map(_annotation, schema["anyOf"]))
    if "$ref" in schema:
        return str(schema["$ref"]).rpartition("/")[2]
    if "const" in schema:
        return f'Literal["{schema["const"]}"]'
    if "prefixItems" in schema:
        return f"tuple[{', '.join(map(_annotation, schema['prefixItems']))}]"
    return f"Sequence[{_annotation(schema['items'])}]" if schema["type"] == "array" else PLAIN[schema["type"]]
