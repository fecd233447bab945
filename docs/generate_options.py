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

'''
INDENT, WIDTH = " " * 4, 118
PLAIN = {"string": "str", "integer": "int", "number": "float", "boolean": "bool", "null": "None"}


def option_types() -> str:
    """Return the module with a typed dictionary for each function that takes options."""
    schemas = {of.__name__: TypeAdapter(of).json_schema() for of in (CalibrationOptions, ReconstructionOptions)}
    shared = {name: schema for each in schemas.values() for name, schema in each.pop("$defs").items()}
    lines = [_literal(name, schema["enum"]) for name, schema in sorted(shared.items()) if "enum" in schema]
    objects = {name: schema for name, schema in (shared | schemas).items() if "enum" not in schema}
    for name, schema in objects.items():
        about = schema["description"].split("\n")[0]
        lines.append(f'\n\nclass {name}(TypedDict, total=False):\n    """{about}"""\n\n')
        lines += [f"    {option}: {_annotation(each)}\n" for option, each in schema["properties"].items()]
    return HEAD + "".join(lines)


def _literal(name: str, values: list[str]) -> str:
    line = f"{name} = Literal[{', '.join(map(chr(34).__add__, (f'{value}{chr(34)}' for value in values)))}]"
    if len(line) <= WIDTH:
        return f"{line}\n"
    wrapping = textwrap.TextWrapper(WIDTH, initial_indent=INDENT, subsequent_indent=INDENT, break_on_hyphens=False)
    body = wrapping.fill(line.partition("[")[2][:-1])
    return f"{name} = Literal[\n{body},\n]\n"


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
