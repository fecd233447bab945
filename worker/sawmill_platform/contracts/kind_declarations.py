"""Declarations of the kinds of jobs, one value a kind, and conditions across several fields in JSON Schema."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from sawmill_platform.contracts.base import Contract
from sawmill_platform.contracts.jobs import JobKind

# A file of this size is read in 5 s, one of 1.4 GB in 27 s (benchmarks/memory.py at 3ab7f653); a packed one
# may hold several times as many samples.
SHORT_UPLOAD_BYTES = 256 * 2**20
# Time to read any file, and the fiftieth part of that rate.
READING_S, READING_BYTES_PER_S = 60.0, 2**20


@dataclass(frozen=True, kw_only=True)
class KindDeclaration:
    """Declaration of a kind of job."""

    kind: JobKind
    noun: str  # the thing that a job of this kind works on, in sentences and codes: `sum` gives `sum-not-found`
    label: str  # name of the work for people, marked for the catalogues
    result: type[Contract]  # type of the answer of `run`
    processor_s: int  # seconds of processor time for each core that a job may use
    time_limit_s: int  # seconds that an attempt may take
    # Seconds for which progress may pause: several times the longest regular pause on a slow machine
    # (`docs/do/run.md#the-life-of-a-job`).
    stall_s: int
    lighter: str  # remedy for a job that takes too long
    upload: str | None = None  # name, in sentences, of the uploaded file that the job reads. None: there is none.
    # Heading under which the history of a job's group keeps the ends of such jobs. None: no history keeps them.
    topic: str | None = None
    # The file for downloads that each success leaves in its folder. None: there is none.
    result_file: str | None = None


@dataclass(frozen=True, kw_only=True)
class UploadedKind(KindDeclaration):
    """Declaration of a kind of job that reads an uploaded file into a row of the kind's own table."""

    upload: str
    processor_s: int = 3600
    time_limit_s: int = 6 * 3600
    stall_s: int = 1800
    lighter: str = "give a smaller file"

    def is_short(self, size_bytes: int) -> bool:
        """Return whether reading a file of this size takes seconds."""
        return size_bytes <= SHORT_UPLOAD_BYTES


def reading_limit_s(size_bytes: int) -> float:
    """Return the seconds after which the reader of a file of this size is in an endless loop."""
    return READING_S + size_bytes / READING_BYTES_PER_S


def declare(declarations: Iterable[KindDeclaration]) -> None:
    """Give the declarations of all kinds to this process, which asks `declaration_of` for them."""
    _DECLARED.update((declaration.kind, declaration) for declaration in declarations)


def declaration_of(kind: JobKind) -> KindDeclaration:
    """Return what a kind declares; raise `LookupError` before `declare`."""
    return _DECLARED[kind]


_DECLARED: dict[JobKind, KindDeclaration] = {}


Schema = dict[str, Any]


def require(schema: Schema, name: str, *alternatives: Schema) -> None:
    """Require one of the alternatives for the whole object where the field is given, besides earlier requirements."""
    conditions = schema.setdefault("dependentSchemas", {}).setdefault(name, {"allOf": []})
    conditions["allOf"].append({"anyOf": list(alternatives)})


def one_of(name: str, values: Iterable[object], *, default: object = None) -> Schema:
    """Return the schema of a field with one of these values; the field may be left out where its default is one."""
    held = list(dict.fromkeys(_plain(value) for value in values))
    condition: Schema = {"properties": {name: {"enum": held}}}
    return condition if _plain(default) in held else condition | {"required": [name]}


def without(*names: str) -> Schema:
    """Return the schema of fields that are null or left out."""
    return {"properties": {name: {"type": "null"} for name in names}}


def bounded(schema: Schema, bounds: Mapping[str, tuple[float, float]]) -> None:
    """Set closer bounds of numbers; a number that may be left out may also be null."""
    for name, (least, largest) in bounds.items():
        schema["properties"][name].pop("exclusiveMinimum", None)
        schema["properties"][name] |= {"minimum": least, "maximum": largest}


def _plain(value: object) -> object:
    """Return the value as JSON has it: an enum's member by its word."""
    return getattr(value, "value", value)
