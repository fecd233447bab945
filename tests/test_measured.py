"""The measured disc, where its data are: the command of docs/measured.md, and the figures of its table."""

import json
import math
import re
import shlex
from contextlib import chdir
from pathlib import Path

import pytest
from PIL import Image
from scan_files import published_data  # noqa: F401 - fixture
from typer.testing import CliRunner

from sawmill_service.cli import main
from sawmill_worker.tomography.geometry import Scanner, SourceFrame
from sawmill_worker.tomography.ray_error import ray_error

pytestmark = pytest.mark.slow

PAGE = Path(__file__).parents[1] / "docs" / "measured.md"


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("measured")


@pytest.fixture
def answer(published_data, folder):  # noqa: F811 - the fixture
    """Of the page's command, run once."""
    written = folder / "disc.json"
    if not written.exists():
        (block,) = re.findall(r"^```sh\n(.*?)^```$", PAGE.read_text(), flags=re.MULTILINE | re.DOTALL)
        command = block.replace("\\\n", " ").replace("$SAWMILL_PUBLISHED_DATA", str(published_data.resolve()))
        program, *arguments, redirected, name = shlex.split(command)
        assert (program, redirected, name) == ("sawmill", ">", written.name)
        with chdir(folder):
            done = CliRunner().invoke(main, arguments)
        assert done.exit_code == 0, done.output
        written.write_text(done.stdout)
    return json.loads(written.read_text())


def test_the_axis_lies_where_the_laboratory_aligned_it(answer):
    """Within three of the answer's standard deviations; how well it was aligned is not known."""
    frame, deviation = answer["source_frame"], answer["standard_deviation"]["source_frame"]
    assert abs(frame["cor_column_mm"]) < min(3.0 * deviation["cor_column_mm"], 0.1)
    assert abs(frame["tilt_rad"]) < min(3.0 * deviation["tilt_rad"], math.radians(0.5))


def test_the_magnification_is_the_laboratory_s(answer):
    """To 0.2 %: half a millimetre in either of its distances makes 0.1 %."""
    assert answer["source_frame"]["magnification"] == pytest.approx(553.74 / 410.66, rel=2e-3)


def test_the_distances_are_as_good_as_the_drawing(answer):
    """Half a millimetre of its outlines, of 35, makes 1.4 %."""
    assert answer["source_frame"]["source_distance_mm"] == pytest.approx(410.66, rel=0.02)
    assert answer["source_frame"]["source_to_detector_mm"] == pytest.approx(553.74, rel=0.02)


def test_rays_and_scale_are_within_their_bounds_of_the_laboratory_s_geometry(answer):
    numbers = {name: value for name, value in answer["source_frame"].items() if name != "magnification"}
    nominal = SourceFrame(0.0, 410.66, 553.74, 0.0, 0.0)
    predicted = answer["predicted_ray_error_mm"]
    off = ray_error(Scanner(410.66, 560, 0.2), nominal, SourceFrame(**numbers), radius_mm=predicted["radius_mm"])
    assert off.rms_mm < predicted["upper_95"] < 0.1
    assert 100.0 * abs(off.scale_change) < answer["scale_uncertainty_percent"]


def test_what_it_is_beyond_the_plain_model_is_named(answer):
    assert answer["residual"]["relative"] < 0.03
    assert any("hardening" in done for done in answer["adjustments"])
    assert any("blur" in done for done in answer["adjustments"])


def test_rays_are_counted_where_the_disc_was(answer):
    assert 35.0 < answer["predicted_ray_error_mm"]["radius_mm"] < 40.0


@pytest.mark.usefixtures("answer")
def test_the_report_is_drawn_though_the_views_do_not_go_all_round(folder):
    with Image.open(folder / "report.png") as page:
        assert min(page.size) > 1000
