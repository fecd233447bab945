"""Flags of a phantom, and checks of their use."""

from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from sawmill_contracts.phantoms import PhantomPicture
from sawmill_vocabulary import BUILT_IN_OUTLINES
from sawmill_worker.commands.from_contract import option


class PhantomShape(StrEnum):
    """Shapes other than a phantom that can be simulated."""

    LOG = "log"
    LOG_WITH_PHANTOM = "log-with-phantom"


@dataclass(frozen=True)
class PhantomSource:
    """A phantom given by the name of a built-in phantom or by its file, and the width of a picture."""

    text: str
    width_mm: float | None

    def __post_init__(self) -> None:
        """Refuse a picture without a width, and a width without a picture."""
        if self.is_built_in and self.width_mm is not None:
            raise typer.BadParameter("--phantom-width-mm is for a picture; a built-in phantom has its size.")
        if self.is_drawing and self.width_mm is not None:
            raise typer.BadParameter("--phantom-width-mm is for a picture; a drawing is in mm already.")
        if not (self.is_built_in or self.is_drawing) and self.width_mm is None:
            raise typer.BadParameter("a phantom's picture needs its width: give --phantom-width-mm.")

    @property
    def path(self) -> Path:
        """Path of the file."""
        return Path(self.text)

    @property
    def is_built_in(self) -> bool:
        """True if the phantom is built in."""
        return self.text in BUILT_IN_OUTLINES

    @property
    def is_drawing(self) -> bool:
        """True if the file is JSON."""
        return not self.is_built_in and self.path.suffix.lower() == ".json"


def existing_phantom(text: str) -> str:
    """Refuse a text that is neither a built-in phantom nor a file (a Typer callback)."""
    if text not in BUILT_IN_OUTLINES and not Path(text).is_file():
        raise typer.BadParameter(f"must be {', '.join(BUILT_IN_OUTLINES)} or an existing file, not {text!r}.")
    return text


def existing_phantoms(texts: list[str]) -> list[str]:
    """Refuse any text that is neither a built-in phantom nor a file (a Typer callback)."""
    return [existing_phantom(text) for text in texts]


def body_or_phantom(text: str) -> str:
    """Refuse a text that is neither a phantom nor a log (a Typer callback)."""
    return text if text in set(PhantomShape) else existing_phantom(text)


def phantom_names() -> list[str]:
    """Return the phantoms that a shell completes."""
    return list(BUILT_IN_OUTLINES)


def body_names() -> list[str]:
    """Return the shapes and phantoms that a shell completes."""
    return [*phantom_names(), *(each.value for each in PhantomShape)]


PhantomText = Annotated[
    str,
    typer.Option(
        "--phantom",
        metavar="NAME|FILE",
        callback=existing_phantom,
        autocompletion=phantom_names,
        help=f"{', '.join(BUILT_IN_OUTLINES)}, a drawing FILE.json, or a picture FILE.png, bright where wood is.",
    ),
]
PhantomWidth = Annotated[
    float | None, option(PhantomPicture, "width_mm", help="Width of a phantom's PNG, the whole picture.")
]
