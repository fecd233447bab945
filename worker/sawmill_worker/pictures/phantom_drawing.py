"""A phantom as a drawing to print at full size: SVG in mm.

As in every picture of an image, down is +x and right is +y (docs/conventions.md#axes), seen as drawn.
"""

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from functools import cache

from jinja2 import Template

from sawmill_contracts.phantoms import PhantomDrawing, extent_of_wood
from sawmill_vocabulary import Point, Shape
from sawmill_worker.templating import templates_of

# Letters of a print, mm; and on a screen as a share of the wood's longer side, to be read at a width of 340 pixels.
_PRINTED_LETTERS_MM, _SHOWN_LETTERS = 5.0, 0.045


@dataclass(frozen=True)
class _Page:
    """Where the box around the wood, from `low` to `high`, and the rotation centre lie on the paper; all in mm."""

    low: Point
    high: Point
    screen: bool = False
    scale_bar: float = 100.0

    @property
    def letters(self) -> float:
        longer = max(self.high[0] - self.low[0], self.high[1] - self.low[1])
        return _SHOWN_LETTERS * longer if self.screen else _PRINTED_LETTERS_MM

    @property
    def margin(self) -> float:
        return (4.0 if self.screen else 6.0) * self.letters

    @property
    def foot_height(self) -> float:
        return 0.0 if self.screen else 30.0

    @property
    def width(self) -> float:
        """Room for the scale bar and its label beside narrow phantoms."""
        shown = self.across(max(self.high[1], 0.0)) - self.margin
        return max(shown, 0.0 if self.screen else 1.6 * self.scale_bar) + 2.0 * self.margin

    @property
    def height(self) -> float:
        return self.down(max(self.high[0], 0.0)) + self.margin + self.foot_height

    @property
    def foot(self) -> float:
        """Where the line with the phantom's name stands."""
        return self.height - self.foot_height

    def across(self, y_mm: float) -> float:
        return y_mm - min(self.low[1], 0.0) + self.margin

    def down(self, x_mm: float) -> float:
        return x_mm - min(self.low[0], 0.0) + self.margin


def phantom_svg(drawing: PhantomDrawing) -> str:
    """A drawing whose unit is the millimetre on paper: outlines, holes, size, rotation centre, name and a scale bar.

    A shape of negative density is drawn as a hole. What cannot be printed of the name is left out.
    """
    return _drawn(drawing.name, dict(enumerate(drawing.shapes)), screen=False)


def shown_svg(name: str, shapes: Mapping[int, Shape], *, wrong: Collection[int] = (), numbered: bool = False) -> str:
    """The same to be put into a page, which gives its colours by the classes of its parts.

    Parameters
    ----------
    name
        What is drawn, for screen readers.
    shapes
        At least one, by their numbers; they need not be a body.
    wrong
        The numbers of those that are not as they should be: they have the class `wrong`.
    numbered
        Whether corners have their numbers beside them.
    """
    return _drawn(name, shapes, screen=True, wrong=wrong, numbered=numbered)


def outline_svg(drawing: PhantomDrawing) -> str:
    """A small picture for a list: the shapes alone, in tones that can be seen on light and on dark ground."""
    low_x, low_y, high_x, high_y = extent_of_wood(drawing.shapes)
    side = max(high_x - low_x, high_y - low_y)
    middle = 0.5 * (low_y + high_y), 0.5 * (low_x + high_x)
    return _template("outline.svg").render(name=_printable(drawing.name), shapes=drawing.shapes, side=side, at=middle)


def _drawn(
    name: str, shapes: Mapping[int, Shape], *, screen: bool, wrong: Collection[int] = (), numbered: bool = False
) -> str:
    low_x, low_y, high_x, high_y = extent_of_wood(shapes.values())
    # Holes last, so that the wood around them does not cover them.
    ordered = sorted(shapes.items(), key=lambda item: item[1].density < 0.0)
    page = _Page((low_x, low_y), (high_x, high_y), screen)
    return _template("phantom.svg").render(
        name=_printable(name), shapes=ordered, page=page, wrong=wrong, numbered=numbered
    )


def _printable(name: str) -> str:
    return "".join(letter for letter in name if letter.isprintable())


@cache
def _template(name: str) -> Template:
    templates = templates_of("sawmill_worker.pictures")
    templates.filters |= {"mm": _number, "length_mm": _length}
    return templates.get_template(name)


def _length(value_mm: float) -> str:
    """To a hundredth, as a workshop can hold it."""
    return f"{round(value_mm, 2) + 0.0:.2f}".rstrip("0").rstrip(".")


def _number(value: float) -> str:
    return f"{value:.4f}".rstrip("0").rstrip(".")
