"""Kinds of problems by code, with their texts for people from `problem_texts/`, which `/problems/` shows.

`tests/service/test_problem_types.py` compares the codes with those that the sources raise.
"""

import tomllib
from collections.abc import Iterator, Mapping
from functools import cache
from http import HTTPStatus
from pathlib import Path
from typing import IO, Any

from pydantic import Field

from sawmill_contracts.declared_kinds import KINDS
from sawmill_platform.contracts.base import Contract
from sawmill_platform.contracts.jobs import FailureKind

PATH = "/problems/"
CODE_PATTERN = r"^[a-z0-9]+(-[a-z0-9]+)*$"
_TEXTS = Path(__file__).parents[1] / "problem_texts"
_OTHERS = "Later versions may add codes: a program treats an unknown code by its status."


class ProblemType(Contract):
    """A kind of problem, or of a job's failure."""

    code: str = Field(
        description="Stable code, for programs.", max_length=64, pattern=CODE_PATTERN, examples=["scanner-not-found"]
    )
    type: str = Field(
        description="Path of this page, as in the `type` of problems.",
        json_schema_extra={"format": "uri-reference"},
        examples=["/problems/scanner-not-found"],
    )
    title: str = Field(description="Meaning of the code, in a few words.", examples=["Nothing has this id"])
    when: str = Field(
        description="Circumstances in which it occurs.",
        examples=["The id is of nothing that is here: it was deleted, or is misspelt."],
    )
    what_to_do: str = Field(description="Remedy.", examples=["List what there is, and take an id from there."])
    status: int | None = Field(
        None, description="HTTP status of an answer with this code; null: only jobs fail with it.", examples=[404]
    )
    failure: FailureKind | None = Field(
        None, description="Cause of the failure where a job fails with this code; null: none does.", examples=["input"]
    )


def type_of(code: str) -> str:
    """Return the `type` of a problem (RFC 9457, section 3.1.1): the path of a page, which works offline as well."""
    return PATH + code


def title_of(code: str, status: int) -> str:
    """Return the meaning of a code in a few words; for an unknown code, the phrase of the status."""
    kind = problem_types().get(code)
    return HTTPStatus(status).phrase if kind is None else kind.title


class ProblemTypes(Contract):
    """List of all kinds of problems, by code."""

    items: list[ProblemType] = Field(description="Kinds of problems in this version, by code.")


@cache
def problem_types() -> Mapping[str, ProblemType]:
    """Return all kinds of problems, by code."""
    kinds = [kind for name in ("answers", "failures") for kind in _read(_TEXTS / f"{name}.toml")]
    return {kind.code: kind for kind in sorted(kinds, key=lambda kind: kind.code)}


def failure_texts(file: IO[bytes], *_: object, **_options: object) -> Iterator[tuple[int, str, str, list[str]]]:
    """Yield the texts of failures for the catalogues, as Babel takes them from an extractor."""
    for entry in tomllib.loads(file.read().decode())["problem"]:
        yield from ((1, "gettext", entry[name], []) for name in ("title", "when", "what_to_do"))


def describe_code(schema: dict[str, Any]) -> None:
    """Complete the schema of a code; an `enum` would break clients of earlier versions."""
    schema.update({"x-extensible-enum": list(problem_types()), "description": f"Stable, for programs. {_OTHERS}"})


def _read(path: Path) -> list[ProblemType]:
    return [
        ProblemType(code=code, type=type_of(code), **entry)
        for entry in tomllib.loads(path.read_text())["problem"]
        for pattern in entry.pop("codes")
        for code in dict.fromkeys(pattern.replace("{noun}", declared.noun) for declared in KINDS)
    ]
