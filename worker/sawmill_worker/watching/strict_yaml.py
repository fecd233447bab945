"""YAML as JSON would have it, with the line of every value: numbers, texts, truth values, lists and objects.

The words are those of YAML 1.2's core schema. So `on` is a text, and so is `10:30`, which YAML 1.1 reads as 630.
Doubled keys, anchors, aliases and tags are refused.
"""

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any, Never

import yaml

LARGEST_BYTES = 2**18

Place = tuple[str | int, ...]


class WrongYaml(Exception):  # noqa: N818 - what is wrong is somebody's file
    """A text that is not read; the sentence has the line."""


@dataclass
class Document:
    """What a text stands for.

    Attributes
    ----------
    value : object
        Of dict, list, str, int, float, bool and None.
    lines : dict
        By the place of each value, keys and indices from the outermost on, the number of its line.
    """

    value: Any = None
    lines: dict[Place, int] = field(default_factory=dict)

    def line_of(self, place: Place) -> int:
        """Of a value, or of the nearest one around it where it is not there."""
        while place and place not in self.lines:
            place = place[:-1]
        return self.lines.get(place, 1)


class _Loader(yaml.SafeLoader):
    """Resolves plain words as YAML 1.2's core schema does."""

    yaml_implicit_resolvers: dict[str, list[tuple[str, re.Pattern[str]]]] = {}  # noqa: RUF012 - as PyYAML declares it


for _tag, _words, _first in (
    ("null", r"~|null|Null|NULL|", "~nN"),
    ("bool", r"true|True|TRUE|false|False|FALSE", "tTfF"),
    ("int", r"[-+]?[0-9]+", "-+0123456789"),
    ("float", r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?", "-+.0123456789"),
):
    _Loader.add_implicit_resolver(f"tag:yaml.org,2002:{_tag}", re.compile(f"(?:{_words})$"), [*_first, ""])


def read_yaml(text: str) -> Document:
    """The one document of a text.

    Raises
    ------
    WrongYaml
        It is no such document.
    """
    if len(text.encode()) > LARGEST_BYTES:
        raise WrongYaml(f"it has more than {LARGEST_BYTES} bytes, which no description of folders needs")
    document = Document()
    loader = _Loader(text)
    try:
        node = loader.get_single_node()
        if node is None:
            raise WrongYaml("it is empty")
        document.value = _Reading(document, loader).value(node, ())
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        raise WrongYaml(f"line {mark.line + 1 if mark else 1}: this is no YAML: {error.problem}") from error
    except (yaml.YAMLError, RecursionError) as error:
        raise WrongYaml(f"this is no YAML: {error}") from error
    finally:
        loader.dispose()
    return document


@dataclass
class _Reading:
    document: Document
    loader: _Loader
    seen: set[int] = field(default_factory=set)

    def value(self, node: yaml.Node, place: Place) -> object:
        self.document.lines[place] = node.start_mark.line + 1
        if id(node) in self.seen:
            _refuse(node, "an alias takes this value again: write it out there, for aliases are not read")
        self.seen.add(id(node))
        if isinstance(node, yaml.MappingNode) and node.tag.endswith(":map"):
            return dict(self._items(node, place))
        if isinstance(node, yaml.SequenceNode) and node.tag.endswith(":seq"):
            return [self.value(each, (*place, index)) for index, each in enumerate(node.value)]
        if not isinstance(node, yaml.ScalarNode):
            _refuse(node, f"the tag {node.tag!r} is not read here")
        return self._scalar(node)

    def _items(self, node: yaml.MappingNode, place: Place) -> Iterator[tuple[str, object]]:
        lines: dict[str, int] = {}
        for key, value in node.value:
            name = key.value
            if not isinstance(key, yaml.ScalarNode) or not isinstance(name, str):
                _refuse(key, "a name must be a text")
            if name in lines:
                _refuse(key, f"{name!r} stands here already, in line {lines[name]}: once is right")
            lines[name] = key.start_mark.line + 1
            yield name, self.value(value, (*place, name))
            # That of the name, where the value begins below it.
            self.document.lines[*place, name] = lines[name]

    def _scalar(self, node: yaml.ScalarNode) -> object:
        text, kind = node.value, node.tag.rpartition(":")[2]
        plain = self.loader.resolve(yaml.ScalarNode, text, (True, False))  # type: ignore[no-untyped-call]
        if kind != "str" and plain != node.tag:
            _refuse(node, f"{text!r} is given the tag {node.tag!r}, which is not read here")
        if kind == "null":
            return None
        if kind == "bool":
            return text.lower() == "true"
        if kind == "int" and len(text) <= len("-1000000000000"):
            return int(text)
        if kind in {"int", "float"}:
            return float(text)
        if kind != "str":
            _refuse(node, f"the tag {node.tag!r} is not read here")
        return text


def _refuse(node: yaml.Node, sentence: str) -> Never:
    raise WrongYaml(f"line {node.start_mark.line + 1}: {sentence}")
