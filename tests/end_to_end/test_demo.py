"""`sawmill demo`, the real one."""

import re
import subprocess
import sys
from contextlib import nullcontext
from pathlib import Path

import h5py
import numpy as np
import pytest
from PIL import Image
from typer.testing import CliRunner

from sawmill_command.commands import main
from sawmill_command.demo import DemoSize, run_demo

pytestmark = pytest.mark.slow


@pytest.mark.nightly
def test_the_demo_leaves_a_page_of_pictures_and_figures(tmp_path, offline):
    elsewhere = {"SAWMILL_DATABASE_URL": "sqlite:////nowhere/the-mills-own.db"}
    command = [sys.executable, "-m", "sawmill_command.commands", "demo", "--output", str(tmp_path / "out")]
    done = subprocess.run(command, env={**offline.variables, **elsewhere}, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    check_demo(tmp_path / "out", done.stdout, error_mm=0.08, relative_error=0.1, size=256)
    assert offline.asked_for() == ""


def test_a_small_demo_leaves_a_page_of_pictures_and_figures(tmp_path, embedded, capsys):
    """A service that runs already does its jobs; the nightly demo starts its own."""
    size = DemoSize(views=60, slices=64, shown=96)
    assert run_demo(tmp_path / "out", size, lambda _: nullcontext(embedded.client)) == 0
    check_demo(tmp_path / "out", capsys.readouterr().out, error_mm=0.1, relative_error=0.15, size=64)


def check_demo(output: Path, printed: str, *, error_mm: float, relative_error: float, size: int) -> None:
    """Hold the figures of a demo against limits: those of both calibrations and of the log."""
    found_mm = [float(text) for text in re.findall(r"ray error ([\d.]+) mm", printed)]
    relative = [float(text) for text in re.findall(r"relative error ([\d.]+)", printed)]
    assert (len(found_mm), len(relative)) == (2, 2)
    assert max(found_mm) < error_mm
    calibrated, by_tape = relative
    assert calibrated < relative_error
    # A tape's few millimetres are seen less in large pixels, where rings leave an error of their own.
    assert by_tape > (3 if size >= 256 else 1.4) * calibrated
    text = (output / "index.html").read_text()
    shown = re.findall(r'(?:src|href)="([^"]+)"', text)
    assert all((output / name).is_file() for name in shown), shown
    assert f"ray error {found_mm[0]:.3f} mm" in text
    pictures = [name for name in shown if name.endswith(".png")]
    assert len(pictures) == 3  # the log before and after, the phantom
    words = " ".join(re.sub(r"<[^>]+>", " ", text[text.index("<body>") :]).split())
    assumed = "COR to detector +3 mm, source shift +3 mm, detector shift -3 mm, detector tilt -0.502° from the truth"
    assert f"Assumed of a tape measure and a spirit level: {assumed}" in words
    for name in pictures:
        with Image.open(output / name) as picture:
            assert np.asarray(picture.convert("L")).std() > 5, "the picture is blank"
    with h5py.File(output / "simulated-log-calibrated.h5") as file:
        assert file["entry/reconstruction/data"].shape == (5, size, size)


def test_a_service_that_cannot_start_ends_the_demo(tmp_path, monkeypatch):
    (tmp_path / "uvicorn.py").write_text("raise ImportError('no web server on this machine')")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    done = CliRunner().invoke(main, ["demo", "--output", str(tmp_path / "out")])
    assert done.exit_code == 1
    assert "The demo stopped: the service ended while starting" in done.output
    assert "no web server on this machine" in done.output
    assert not (tmp_path / "out/index.html").exists()


def test_an_output_that_is_a_file_is_wrong_use(tmp_path):
    (tmp_path / "out").touch()
    done = CliRunner().invoke(main, ["demo", "--output", str(tmp_path / "out")])
    assert done.exit_code == 2
    assert "is a file" in " ".join(done.stderr.replace("│", " ").split())
