"""Flags from contracts: type, bounds, default and description of a flag are declared only in the contract."""

import inspect
import types
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cache, wraps
from typing import Annotated, Any, Union, get_args, get_origin

import typer
from pydantic import BaseModel, TypeAdapter, ValidationError
from pydantic.dataclasses import is_pydantic_dataclass
from pydantic_core import ErrorDetails
from typer.models import OptionInfo
from typing_extensions import TypeAliasType

from sawmill_platform.contracts.base import complaint

# A model or a dataclass of pydantic: both have `__pydantic_fields__`.
ContractType = Any
# Pydantic's error types for a number beyond its bounds.
OUT_OF_BOUNDS = frozenset({"greater_than", "greater_than_equal", "less_than", "less_than_equal"})


class Flags:
    """Additions of a command to a contract's fields: arguments of `typer.Option`, `flag`, `default`; None: no flag."""

    def __init__(self, **fields: Mapping[str, Any] | None) -> None:
        self._fields = fields

    def leaves_out(self, name: str) -> bool:
        """Return whether the field is left out, so that it is no flag."""
        return name in self._fields and self._fields[name] is None

    def added_to(self, name: str) -> dict[str, Any]:
        """Return the additions to the field."""
        return dict(self._fields.get(name) or {})


def field_names(model: ContractType) -> list[str]:
    """Return the names of a contract's fields, in their order."""
    return list(model.__pydantic_fields__)


def option(model: ContractType, name: str, *, flag: str | None = None, **changes: Any) -> OptionInfo:  # noqa: ANN401 - Typer's
    """Create the flag of a contract's field: its description, and its bounds, which the contract itself checks."""
    field = model.__pydantic_fields__[name]
    # Typer's help has no exclusive bounds.
    bounds = FieldBounds.of(model, name)
    low, high = (bounds.low, bounds.high) if bounds.low_itself and bounds.high_itself else (None, None)
    settings: dict[str, Any] = {
        "help": field.description or "",
        "min": low,
        "max": high,
        "callback": _checked(model, name),
    }
    info: OptionInfo = typer.Option(*(() if flag is None else (flag,)), **(settings | changes))
    return info


def from_contracts(command: Callable[..., None]) -> Callable[..., None]:
    """Turn the contract parameters of a command into one Typer flag per field; what a contract refuses is wrong use."""
    groups: dict[str, _Group] = {}
    parameters = [inspect.Parameter("context", inspect.Parameter.KEYWORD_ONLY, annotation=typer.Context)]
    for name, parameter in inspect.signature(command, eval_str=True).parameters.items():
        group = _group_of(parameter.annotation)
        if group is None:
            parameters.append(parameter.replace(kind=inspect.Parameter.KEYWORD_ONLY))
        else:
            groups[name] = group
            parameters += group.parameters()

    @wraps(command)
    def run(context: typer.Context, **values: Any) -> None:  # noqa: ANN401 - of the flags
        sources = {name: context.get_parameter_source(name) for name in values}
        given = {name for name, source in sources.items() if source is not None and source.name != "DEFAULT"}
        with wrong_use():
            contracts = {name: group.read(values, given) for name, group in groups.items()}
        command(**values, **contracts)

    # Arguments and required flags come first in the help.
    ordered = sorted(parameters, key=lambda each: each.default is not inspect.Parameter.empty)
    run.__signature__ = inspect.Signature(ordered)  # type: ignore[attr-defined]
    return run


@dataclass(frozen=True)
class _Group:
    """The flags of a contract; flags of a nested contract begin with the name of the nested contract."""

    model: ContractType
    flags: Flags
    prefix: str = ""

    def parameters(self) -> Iterator[inspect.Parameter]:
        for name, field in self.model.__pydantic_fields__.items():
            inner = self._inside(name)
            if inner is not None:
                yield from inner.parameters()
            elif not self.flags.leaves_out(name):
                yield self._parameter(name, field.get_default(call_default_factory=True, validated_data={}))

    def read(self, values: dict[str, Any], given: set[str]) -> Any:  # noqa: ANN401 - of any contract
        """Take the contract's values out of all values of the command line."""
        fields = {}
        for name in self.model.__pydantic_fields__:
            inner = self._inside(name)
            if inner is not None:
                fields[name] = inner.read(values, given)
            elif not self.flags.leaves_out(name):
                value = values.pop(self.prefix + name)
                if self.prefix + name in given or "default" in self.flags.added_to(name):
                    fields[name] = value
        return TypeAdapter(self.model).validate_python(fields)

    def _inside(self, name: str) -> "_Group | None":
        inner = _group_of(self.model.__pydantic_fields__[name].annotation)
        return None if inner is None else replace(inner, prefix=f"{self.prefix}{name}_")

    def _parameter(self, name: str, own_default: object) -> inspect.Parameter:
        added = self.flags.added_to(name)
        default = added.pop("default", own_default)
        if default is False:
            added.setdefault("flag", f"--{(self.prefix + name).replace('_', '-')}")
        kind = _typed_as(self.model.__pydantic_fields__[name].annotation)
        annotated = Annotated[kind, option(self.model, name, **added)]  # type: ignore[valid-type]
        if self.model.__pydantic_fields__[name].is_required() and default is own_default:
            default = inspect.Parameter.empty
        elif default == []:
            default = None
        return inspect.Parameter(
            self.prefix + name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=annotated
        )


def _group_of(annotation: object) -> _Group | None:
    """Return the flags of a parameter or field whose type is a contract; None if it is a single flag."""
    model, *added = get_args(annotation) if get_origin(annotation) is Annotated else (annotation,)
    is_contract = isinstance(model, type) and (issubclass(model, BaseModel) or is_pydantic_dataclass(model))
    if not is_contract or any(isinstance(each, OptionInfo) for each in added):
        return None
    return _Group(model, next((each for each in added if isinstance(each, Flags)), Flags()))


def _typed_as(annotation: object) -> object:
    """Return the type that Typer reads: without None, name and bounds; several numbers are one text."""
    if isinstance(annotation, TypeAliasType):
        return _typed_as(annotation.__value__)
    if get_origin(annotation) is Annotated:
        return _typed_as(get_args(annotation)[0])
    if get_origin(annotation) in {Union, types.UnionType}:
        [kept] = (each for each in get_args(annotation) if each is not type(None))
        return _typed_as(kept)
    return str if get_origin(annotation) is tuple else annotation


def _checked(model: ContractType, name: str) -> Callable[[Any], Any]:
    """Create a Typer callback that refuses the values that the contract's field refuses."""

    def check(value: Any) -> Any:  # noqa: ANN401 - any flag's
        if value is None:
            return None
        try:
            TypeAdapter(model).validate_python({name: value})
        except ValidationError as error:
            faults = [each for each in error.errors() if each["loc"][:1] == (name,)]
            if faults:
                raise typer.BadParameter(sentence(faults[0], model)) from error
        return value

    return check


@dataclass(frozen=True)
class FieldBounds:
    """Bounds of a number in a contract."""

    low: float | None
    high: float | None
    low_itself: bool
    high_itself: bool

    @classmethod
    def of(cls, model: ContractType, name: str) -> "FieldBounds":
        """Read the bounds of a contract's field."""
        written = _properties(model)[name]
        schema = next((each for each in written.get("anyOf", ()) if each.get("type") != "null"), written)
        low, high = schema.get("minimum"), schema.get("maximum")
        above, below = schema.get("exclusiveMinimum"), schema.get("exclusiveMaximum")
        if schema.get("type") == "integer":
            low, above = (low, None) if above is None else (above + 1, None)
            high, below = (high, None) if below is None else (below - 1, None)
        return cls(low if above is None else above, high if below is None else below, above is None, below is None)

    def __str__(self) -> str:
        """Describe the bounds, for example "above 0 and at most 1"."""
        low = "" if self.low is None else f"{'at least' if self.low_itself else 'above'} {self.low:.10g}"
        high = "" if self.high is None else f"{'at most' if self.high_itself else 'below'} {self.high:.10g}"
        return " and ".join(filter(None, (low, high)))


@cache
def _properties(model: ContractType) -> dict[str, Any]:
    properties: dict[str, Any] = TypeAdapter(model).json_schema()["properties"]
    return properties


def sentence(error: ErrorDetails, model: ContractType) -> str:
    """Return a contract's refusal of one value as a sentence."""
    if error["type"] in OUT_OF_BOUNDS and len(error["loc"]) == 1:
        return f"must be {FieldBounds.of(model, str(error['loc'][0]))}, not {error['input']}"
    return error["msg"].removeprefix("Value error, ")


@contextmanager
def wrong_use() -> Iterator[None]:
    """Turn a contract's refusal into wrong use."""
    try:
        yield
    except ValidationError as error:
        raise typer.BadParameter(complaint(error)) from error
