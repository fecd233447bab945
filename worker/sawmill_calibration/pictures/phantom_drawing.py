"""Drawing of a phantom to print at full size: SVG in mm.

Down is +x and right is +y (docs/look-up/conventions.md#axes), as in every picture of an image.
"""

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from functools import cache

from jinja2 import Template

from sawmill_calibration.pictures.templating import templates_of
from sawmill_contracts.phantoms import PhantomDrawing, extent_of_wood
from sawmill_vocabulary import Point, Shape

# Height of letters in print, mm, and on a screen as a share of the wood's longer side, readable at 340 pixels' width.
_PRINTED_LETTERS_MM, _SHOWN_LETTERS = 5.0, 0.045


@dataclass(frozen=True)
class _Page:
    """Positions on the paper of the box around the wood, from `low` to `high`, and of the rotation centre, mm."""

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
        """Width of the page, with room for the scale bar and its label at narrow phantoms."""
        shown = self.across(max(self.high[1], 0.0)) - self.margin
        return max(shown, 0.0 if self.screen else 1.6 * self.scale_bar) + 2.0 * self.margin

    @property
    def height(self) -> float:
        return self.down(max(self.high[0], 0.0)) + self.margin + self.foot_height

    @property
    def foot(self) -> float:
        """Position of the line with the phantom's name."""
        return self.height - self.foot_height

    def across(self, y_mm: float) -> float:
        return y_mm - min(self.low[1], 0.0) + self.margin

    def down(self, x_mm: float) -> float:
        return x_mm - min(self.low[0], 0.0) + self.margin


def phantom_svg(drawing: PhantomDrawing) -> str:
    """Draw a phantom in millimetres on paper: outlines, holes, size, rotation centre, name and a scale bar.

    A shape of negative density is drawn as a hole. Characters of the name that cannot be printed are left out.
    """
    return _drawn(drawing.name, dict(enumerate(drawing.shapes)), screen=False)


def shown_svg(name: str, shapes: Mapping[int, Shape], *, wrong: Collection[int] = (), numbered: bool = False) -> str:
    """Draw a phantom for a web page, which sets the colours by the classes of the parts.

    Parameters
    ----------
    name
        Name of the drawing, for screen readers.
    shapes
        At least one shape, by number; the shapes need not form a phantom.
    wrong
        Numbers of the faulty shapes, which get the class `wrong`.
    numbered
        True to label the corners with their numbers.
    """
    return _drawn(name, shapes, screen=True, wrong=wrong, numbered=numbered)


def outline_svg(drawing: PhantomDrawing) -> str:
    """Draw a small picture for a list: only the shapes, in tones that are visible on light and dark backgrounds."""
    low_x, low_y, high_x, high_y = extent_of_wood(drawing.shapes)
    side = max(high_x - low_x, high_y - low_y)
    middle = 0.5 * (low_y + high_y), 0.5 * (low_x + high_x)
    return _template("outline.svg").render(name=_printable(drawing.name), shapes=drawing.shapes, side=side, at=middle)


def _drawn(
    name: str, shapes: Mapping[int, Shape], *, screen: bool, wrong: Collection[int] = (), numbered: bool = False
) -> str:
    low_x, low_y, high_x, high_y = extent_of_wood(shapes.values())
    # Holes are drawn last, so that the surrounding wood does not cover the holes.
    ordered = sorted(shapes.items(), key=lambda item: item[1].density < 0.0)
    page = _Page((low_x, low_y), (high_x, high_y), screen)
    return _template("phantom.svg").render(
        name=_printable(name), shapes=ordered, page=page, wrong=wrong, numbered=numbered
    )


def _printable(name: str) -> str:
    return "".join(letter for letter in name if letter.isprintable())


@cache
def _template(name: str) -> Template:
    templates = templates_of("sawmill_calibration.pictures")
    templates.filters |= {"mm": _number, "length_mm": _length}
    return templates.get_template(name)


def _length(value_mm: float) -> str:
    """Format a length to a hundredth of a millimetre, the precision of a workshop."""
    return f"{round(value_mm, 2) + 0.0:.2f}".rstrip("0").rstrip(".")


def _number(value: float) -> str:
    return f"{value:.4f}".rstrip("0").rstrip(".")
