"""Pictures that no drawing can be made of: refused as `phantom`, in one sentence, before they take long."""

import numpy as np
import pytest
from PIL import Image

from sawmill_calibration.failures import input_errors_translated
from sawmill_calibration.phantom_drawings import traced_drawing
from sawmill_platform.contracts.attempts import JobFailure


def square(side):
    picture = np.zeros((side, side), np.uint8)
    picture[side // 4 : side // 2, side // 4 : side // 2] = 255
    return picture


def spiral(side):
    """One line of 1.5 pixels, wound up to the border."""
    y, x = np.mgrid[:side, :side] - 0.5 * (side - 1)
    turns, radius = np.arctan2(y, x) / (2.0 * np.pi), np.hypot(x, y)
    on_line = (radius / 3.0 - turns) % 1.0 < 0.5
    return np.where(on_line & (radius > 4.0) & (radius < 0.5 * side - 4.0), 255, 0).astype(np.uint8)


@pytest.mark.parametrize(
    ("picture", "width_mm", "sentence"),
    [
        (spiral(360), 400.0, "an outline of the picture has more than 2000 corners, .*: give a clean drawing"),
        (
            square(40),
            1e9,
            "the picture shows no phantom that can be drawn: Input should be greater than or equal to -100000",
        ),
        (square(40), 1e-300, r"the picture's width is 1e-300 mm: give the width .*, at least 0\.1 mm"),
    ],
    ids=["spiral", "too large", "no width"],
)
def test_what_no_drawing_can_be_made_of_is_refused(tmp_path, picture, width_mm, sentence):
    path = tmp_path / "picture.png"
    Image.fromarray(picture).save(path)
    with pytest.raises(JobFailure, match=sentence) as failure, input_errors_translated():
        traced_drawing(path, width_mm, name="none")
    assert failure.value.code == "phantom"
