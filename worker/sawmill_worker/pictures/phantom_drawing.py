"""A phantom as a drawing to print at full size: SVG in mm.

As in every picture of an image, down is +x and right is +y (DESIGN section 3), seen as drawn.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable
from xml.etree import ElementTree as ET

Point = tuple[float, float]

MARGIN_MM = 30.0
FOOT_MM = 30.0
SCALE_BAR_MM = 100.0
TEXT_MM = 5.0
LINE_MM = 0.35
THIN_MM = 0.18
ARROW_MM = 3.0
CROSS_MM = 8.0
INK = "#000"
DIMENSION = "#456"
WOOD = "#e9d9b8"
PAPER = "#fff"


@runtime_checkable
class PolygonShape(Protocol):
    """A closed polygon."""

    @property
    def vertices_mm(self) -> Sequence[Point]:
        """(x, y) of each corner."""

    @property
    def density(self) -> float:
        """Below 0 for a hole."""


@runtime_checkable
class DiscShape(Protocol):
    """A disc."""

    @property
    def center_mm(self) -> Point:
        """(x, y)."""

    @property
    def radius_mm(self) -> float:
        """Half its diameter."""

    @property
    def density(self) -> float:
        """Below 0 for a hole."""


Shape = PolygonShape | DiscShape


@dataclass(frozen=True)
class _Page:
    """Where the box of the phantom and its rotation centre lies on the paper, all in mm."""

    low: Point
    high: Point

    @property
    def width(self) -> float:
        """Room for the scale bar and its label beside narrow phantoms."""
        return max(self.high[1] - self.low[1], 1.6 * SCALE_BAR_MM) + 2.0 * MARGIN_MM

    @property
    def height(self) -> float:
        return self.high[0] - self.low[0] + 2.0 * MARGIN_MM + FOOT_MM

    @property
    def foot(self) -> float:
        return self.height - FOOT_MM

    def across(self, y_mm: float) -> float:
        return y_mm - self.low[1] + MARGIN_MM

    def down(self, x_mm: float) -> float:
        return x_mm - self.low[0] + MARGIN_MM


def phantom_svg(name: str, shapes: Sequence[Shape]) -> str:
    """A drawing whose unit is the millimetre on paper: outlines, holes, size, rotation centre, name and a scale bar.

    Parameters
    ----------
    name : str
        Stands below the drawing; what cannot be printed is left out.
    shapes : sequence of polygons and discs, at least one
        A shape of negative density is drawn as a hole.
    """
    low, high = _box(shapes)
    page = _Page((min(low[0], 0.0), min(low[1], 0.0)), (max(high[0], 0.0), max(high[1], 0.0)))
    root = ET.Element(
        "svg",
        {
            "xmlns": "http://www.w3.org/2000/svg",
            "width": f"{_number(page.width)}mm",
            "height": f"{_number(page.height)}mm",
            "viewBox": f"0 0 {_number(page.width)} {_number(page.height)}",
            "font-family": "sans-serif",
            "font-size": _number(TEXT_MM),
        },
    )
    title = "".join(letter for letter in name if letter.isprintable())
    ET.SubElement(root, "title").text = title
    ET.SubElement(root, "rect", {"width": "100%", "height": "100%", "fill": PAPER})
    # Holes last, so that the wood around them does not cover them.
    for shape in sorted(shapes, key=lambda shape: shape.density < 0.0):
        _draw_shape(root, page, shape)
    for shape in shapes:
        if isinstance(shape, DiscShape):
            _label_disc(root, page, shape)
    _draw_centre(root, page)
    _draw_size(root, (page.across(low[1]), page.down(low[0])), (page.across(high[1]), page.down(high[0])))
    _draw_foot(root, page, title)
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{ET.tostring(root, encoding="unicode")}\n'


def _box(shapes: Sequence[Shape]) -> tuple[Point, Point]:
    """The corners of the smallest upright box around the shapes, holes left out where there is wood."""
    corners: list[Point] = []
    for shape in [shape for shape in shapes if shape.density > 0.0] or shapes:
        if isinstance(shape, DiscShape):
            (x, y), radius = shape.center_mm, shape.radius_mm
            corners += [(x - radius, y - radius), (x + radius, y + radius)]
        else:
            corners += shape.vertices_mm
    low = min(x for x, _ in corners), min(y for _, y in corners)
    return low, (max(x for x, _ in corners), max(y for _, y in corners))


def _draw_shape(root: ET.Element, page: _Page, shape: Shape) -> None:
    look = {"fill": PAPER if shape.density < 0.0 else WOOD, "stroke": INK, "stroke-width": _number(LINE_MM)}
    if isinstance(shape, DiscShape):
        x, y = shape.center_mm
        place = {"cx": page.across(y), "cy": page.down(x), "r": shape.radius_mm}
        ET.SubElement(root, "circle", {key: _number(value) for key, value in place.items()} | look)
    else:
        points = " ".join(f"{_number(page.across(y))},{_number(page.down(x))}" for x, y in shape.vertices_mm)
        ET.SubElement(root, "polygon", {"points": points, "stroke-linejoin": "miter"} | look)


def _label_disc(root: ET.Element, page: _Page, disc: DiscShape) -> None:
    x, y = disc.center_mm
    across, down = page.across(y), page.down(x)
    _cross(root, across, down, 0.5 * CROSS_MM)
    label = f"⌀ {_length(2.0 * disc.radius_mm)} at ({_length(x)}, {_length(y)})"
    _text(root, across, down + disc.radius_mm + 1.2 * TEXT_MM, label, anchor="middle")


def _draw_centre(root: ET.Element, page: _Page) -> None:
    """The rotation centre, and which way x and y count."""
    across, down = page.across(0.0), page.down(0.0)
    _cross(root, across, down, CROSS_MM)
    circle = {"cx": _number(across), "cy": _number(down), "r": _number(0.4 * CROSS_MM), "fill": "none"}
    ET.SubElement(root, "circle", circle | {"stroke": INK, "stroke-width": _number(THIN_MM)})
    _text(root, across + 0.5 * TEXT_MM, down + CROSS_MM + 0.6 * TEXT_MM, "x")
    _text(root, across + CROSS_MM + 0.4 * TEXT_MM, down - 0.3 * TEXT_MM, "y")


def _draw_size(root: ET.Element, low: Point, high: Point) -> None:
    """The two lengths of the phantom's box, above and to the left, from its corners on the paper."""
    (left, top), (right, bottom) = low, high
    line = 0.5 * MARGIN_MM
    _dimension(root, (left, line), (right, line))
    _text(root, 0.5 * (left + right), line - 0.4 * TEXT_MM, _length(right - left), anchor="middle")
    _dimension(root, (line, top), (line, bottom))
    label = _text(root, 0.0, 0.0, _length(bottom - top), anchor="middle")
    middle = f"translate({_number(line - 0.4 * TEXT_MM)} {_number(0.5 * (top + bottom))}) rotate(-90)"
    label.set("transform", middle)
    for across, down in ((left, top), (right, top)):
        _line(root, (across, down - 2.0), (across, line - 2.0), colour=DIMENSION)
    for across, down in ((left, top), (left, bottom)):
        _line(root, (across - 2.0, down), (line - 2.0, down), colour=DIMENSION)


def _draw_foot(root: ET.Element, page: _Page, title: str) -> None:
    """The name, and a bar by which a print can be checked with a ruler."""
    _text(root, MARGIN_MM, page.foot, title).set("font-weight", "bold")
    down = page.foot + 1.4 * TEXT_MM
    end = MARGIN_MM + SCALE_BAR_MM
    _line(root, (MARGIN_MM, down), (end, down), width=4.0 * LINE_MM)
    for across in (MARGIN_MM, end):
        _line(root, (across, down - 2.0), (across, down + 2.0), width=LINE_MM)
    _text(root, end + TEXT_MM, down + 0.35 * TEXT_MM, f"{_length(SCALE_BAR_MM)} mm")
    note = "Print at 100 %; lengths in mm. The cross in a circle is the rotation centre."
    _text(root, MARGIN_MM, down + 1.8 * TEXT_MM, note).set("font-size", _number(0.7 * TEXT_MM))


def _dimension(root: ET.Element, start: Point, end: Point) -> None:
    """A line with an arrow at each end, upright or level; no arrows where it has no length."""
    _line(root, start, end, colour=DIMENSION)
    length = max(abs(end[0] - start[0]), abs(end[1] - start[1]))
    if length == 0.0:
        return
    along = ((end[0] - start[0]) / length, (end[1] - start[1]) / length)
    reach = min(ARROW_MM, 0.4 * length)
    for tip, sign in ((start, 1.0), (end, -1.0)):
        base = (tip[0] + sign * reach * along[0], tip[1] + sign * reach * along[1])
        side = (0.3 * reach * along[1], 0.3 * reach * along[0])
        corners = (tip, (base[0] + side[0], base[1] + side[1]), (base[0] - side[0], base[1] - side[1]))
        points = " ".join(f"{_number(x)},{_number(y)}" for x, y in corners)
        ET.SubElement(root, "polygon", {"points": points, "fill": DIMENSION})


def _cross(root: ET.Element, across: float, down: float, reach: float) -> None:
    _line(root, (across - reach, down), (across + reach, down))
    _line(root, (across, down - reach), (across, down + reach))


def _line(root: ET.Element, start: Point, end: Point, *, colour: str = INK, width: float = THIN_MM) -> None:
    ends = {"x1": start[0], "y1": start[1], "x2": end[0], "y2": end[1], "stroke-width": width}
    ET.SubElement(root, "line", {key: _number(value) for key, value in ends.items()} | {"stroke": colour})


def _text(root: ET.Element, across: float, down: float, words: str, *, anchor: str = "start") -> ET.Element:
    place = {"x": _number(across), "y": _number(down), "text-anchor": anchor, "fill": INK}
    element = ET.SubElement(root, "text", place)
    element.text = words
    return element


def _length(value_mm: float) -> str:
    """To a hundredth, as a workshop can hold it."""
    return f"{round(value_mm, 2) + 0.0:.2f}".rstrip("0").rstrip(".")


def _number(value: float) -> str:
    return f"{value:.4f}".rstrip("0").rstrip(".")
