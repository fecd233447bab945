"""A phantom as a drawing to print at full size: SVG in mm.

As in every picture of an image, down is +x and right is +y (docs/conventions.md#axes), seen as drawn.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

from jinja2 import Template

from sawmill_worker.contracts.phantoms import PhantomDrawing
from sawmill_worker.templating import templates_of
from sawmill_worker.vocabulary import Disc, Point, Shape


@dataclass(frozen=True)
class _Page:
    """Where the box around the wood, from `low` to `high`, and the rotation centre lie on the paper; all in mm."""

    low: Point
    high: Point
    margin: float = 30.0
    foot_height: float = 30.0
    scale_bar: float = 100.0

    @property
    def width(self) -> float:
        """Room for the scale bar and its label beside narrow phantoms."""
        shown = self.across(max(self.high[1], 0.0)) - self.margin
        return max(shown, 1.6 * self.scale_bar) + 2.0 * self.margin

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
    name = "".join(letter for letter in drawing.name if letter.isprintable())
    # Holes last, so that the wood around them does not cover them.
    shapes = sorted(drawing.shapes, key=lambda shape: shape.density < 0.0)
    return _template().render(name=name, shapes=shapes, page=_Page(*_box(shapes)))


@cache
def _template() -> Template:
    templates = templates_of("sawmill_worker.pictures")
    templates.filters |= {"mm": _number, "length_mm": _length}
    return templates.get_template("phantom.svg")


def _box(shapes: Sequence[Shape]) -> tuple[Point, Point]:
    """The corners of the smallest upright box around the shapes, holes left out where there is wood."""
    corners: list[Point] = []
    for shape in [shape for shape in shapes if shape.density > 0.0] or shapes:
        if isinstance(shape, Disc):
            (x, y), radius = shape.center_mm, shape.radius_mm
            corners += [(x - radius, y - radius), (x + radius, y + radius)]
        else:
            corners += shape.vertices_mm
    low = min(x for x, _ in corners), min(y for _, y in corners)
    return low, (max(x for x, _ in corners), max(y for _, y in corners))


def _length(value_mm: float) -> str:
    """To a hundredth, as a workshop can hold it."""
    return f"{round(value_mm, 2) + 0.0:.2f}".rstrip("0").rstrip(".")


def _number(value: float) -> str:
    return f"{value:.4f}".rstrip("0").rstrip(".")
