"""Registered words: open sets of names, such as the kinds of jobs, to which each package adds its own."""

import difflib
from typing import Any, ClassVar, Self

from pydantic import GetJsonSchemaHandler
from pydantic_core import CoreSchema, PydanticCustomError, core_schema


class RegisteredWord(str):  # noqa: SLOT000 - subclasses have attributes
    """A word of an open set. Each subclass is a set; the public document lists its words as an enumeration."""

    _words: ClassVar[dict[str, Any]]

    def __init_subclass__(cls) -> None:
        """Begin an empty set."""
        cls._words = {}

    @classmethod
    def _add(cls, word: str, **attributes: object) -> Self:
        """Add a word with its attributes, or raise `ValueError` if the set has it already."""
        if word in cls._words:
            msg = f"{cls.__name__} has {word!r} already"
            raise ValueError(msg)
        added = cls._words[word] = str.__new__(cls, word)
        vars(added).update(attributes)
        return added

    @classmethod
    def all(cls) -> tuple[Self, ...]:
        """Return the words in the order of their registration."""
        return tuple(cls._words.values())

    @classmethod
    def of(cls, word: str) -> Self:
        """Return the registered word, or raise `LookupError`."""
        found: Self | None = cls._words.get(word)
        if found is None:
            near = difflib.get_close_matches(word, cls._words, n=1)
            msg = f"{cls.__name__} has no {word!r}" + (f"; did you mean {near[0]!r}?" if near else "")
            raise LookupError(msg)
        return found

    def __copy__(self) -> Self:
        """Return the word itself: words are compared by identity."""
        return self

    def __deepcopy__(self, memo: dict[int, Any]) -> Self:
        """Return the word itself: words are compared by identity."""
        return self

    @classmethod
    def __get_pydantic_core_schema__(cls, source: object, handler: object) -> CoreSchema:
        """Accept the words of the set, whichever are registered by then."""
        named = f"{cls.__module__}.{cls.__qualname__}"
        return core_schema.no_info_after_validator_function(cls._checked, core_schema.str_schema(), ref=named)

    @classmethod
    def __get_pydantic_json_schema__(cls, schema: CoreSchema, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        """List the words as an enumeration."""
        return {"type": "string", "title": cls.__name__, "description": cls.__doc__, "enum": [*map(str, cls.all())]}

    @classmethod
    def _checked(cls, word: str) -> Self:
        try:
            return cls.of(word)
        except LookupError:
            *most, last = (repr(str(each)) for each in cls.all())
            expected = f"{', '.join(most)} or {last}" if most else last
            raise PydanticCustomError("enum", "Input should be {expected}", {"expected": expected}) from None
