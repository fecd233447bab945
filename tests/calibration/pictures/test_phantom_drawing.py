import xml.etree.ElementTree as ET

import pytest

from sawmill_calibration.pictures.phantom_drawing import phantom_svg
from sawmill_contracts.phantoms import PhantomDrawing
from sawmill_vocabulary import Disc, Polygon

SVG = "{http://www.w3.org/2000/svg}"


BOARD = Polygon(vertices_mm=[(-100.0, -150.0), (100.0, -150.0), (100.0, 150.25), (-100.0, 150.25)])


def disc(x_mm: float, y_mm: float, radius_mm: float, density: float = 1.0) -> Disc:
    return Disc(center_mm=(x_mm, y_mm), radius_mm=radius_mm, density=density)


HOLE = disc(-50.0, -49.0, 26.0, -1.0)


def drawn(name: str, *shapes: Polygon | Disc) -> ET.Element:
    return ET.fromstring(phantom_svg(PhantomDrawing(name=name, shapes=shapes)))  # noqa: S314 - our own text


def outline(root: ET.Element) -> list[tuple[float, float]]:
    """The first polygon's corners on the paper, (right, down)."""
    return [tuple(map(float, point.split(","))) for point in root.find(f"{SVG}polygon").get("points").split()]


def words(root: ET.Element) -> list[str]:
    return [element.text for element in root.iter(f"{SVG}text")]


def test_a_unit_is_a_millimetre_on_paper():
    root = drawn("board", BOARD)
    width, height = root.get("width"), root.get("height")
    assert width.endswith("mm")
    assert height.endswith("mm")
    assert root.get("viewBox") == f"0 0 {width.removesuffix('mm')} {height.removesuffix('mm')}"


def test_down_is_x_and_right_is_y():
    corners = outline(drawn("board", BOARD))
    across, down = corners[0]
    expected = [(across + y + 150.0, down + x + 100.0) for x, y in BOARD.vertices_mm]
    assert sum(corners, ()) == pytest.approx(sum(expected, ()))


def test_a_hole_is_cut_into_the_wood_whatever_the_order():
    for shapes in ((BOARD, HOLE), (HOLE, BOARD)):
        root = drawn("board", *shapes)
        filled = [element for element in root if element.tag in {f"{SVG}polygon", f"{SVG}circle"}]
        wood, hole = filled[:2]
        assert wood.get("fill") != hole.get("fill") == "#fff"
        across, down = outline(root)[0]
        assert float(hole.get("r")) == 26.0
        assert (float(hole.get("cx")), float(hole.get("cy"))) == pytest.approx((across + 101.0, down + 50.0))


def test_sizes_name_and_scale_are_written():
    written = words(drawn("board", BOARD, HOLE))
    assert {"300.25", "200", "board", "100 mm", "⌀ 52 at (-50, -49)"} <= set(written)


def test_the_scale_bar_is_a_hundred_millimetres():
    root = drawn("board", BOARD)
    thickest = max(root.iter(f"{SVG}line"), key=lambda line: float(line.get("stroke-width")))
    assert float(thickest.get("x2")) - float(thickest.get("x1")) == pytest.approx(100.0)


def test_everything_lies_on_the_paper_the_rotation_centre_too():
    root = drawn("beside", disc(60.0, 90.0, 20.0), disc(-300.0, 40.0, 5.0, -1.0))
    width, height = (float(root.get(name).removesuffix("mm")) for name in ("width", "height"))
    (mark,) = [circle for circle in root.iter(f"{SVG}circle") if circle.get("fill") == "none"]
    assert 0.0 < float(mark.get("cx")) < width
    assert 0.0 < float(mark.get("cy")) < height
    assert {"40"} <= set(words(root))


@pytest.mark.parametrize("name", ["a <b> & 'c'", "bell\x07", "none\ufffe"])
def test_any_name_makes_valid_xml(name):
    root = drawn(name, BOARD)
    assert root.findtext(f"{SVG}title") == "".join(letter for letter in name if letter.isprintable())
