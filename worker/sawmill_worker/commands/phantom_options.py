"""Flags of a phantom, and checks of their use."""

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


def check_width(phantom: str, width_mm: float | None) -> None:
    """Refuse a picture without a width, and a width without a picture."""
    if phantom in BUILT_IN_OUTLINES and width_mm is not None:
        raise typer.BadParameter("--phantom-width-mm is for a picture; a built-in phantom has its size.")
    is_drawing = Path(phantom).suffix.lower() == ".json"
    if is_drawing and width_mm is not None:
        raise typer.BadParameter("--phantom-width-mm is for a picture; a drawing is in mm already.")
    if not (phantom in BUILT_IN_OUTLINES or is_drawing) and width_mm is None:
        raise typer.BadParameter("a phantom's picture needs its width: give --phantom-width-mm.")


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
