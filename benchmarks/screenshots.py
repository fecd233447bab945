"""The pictures in docs/pictures: the pages as Chromium shows them, and one log before and after its calibration.

    make screenshots
    python benchmarks/screenshots.py [--data FOLDER] [--only NAME]

The service runs on a data folder with two months of a mill (`mill_history.py`), which takes some minutes to compute.
`--data` keeps the folder, and takes one that is there. Debian's Chromium is needed.
"""

import argparse
import io
import shutil
import sys
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path

import httpx
import matplotlib as mpl
import numpy as np
from mill_history import PastClock, write_history
from numpy.typing import NDArray
from PIL import Image
from playwright.sync_api import Browser, Page, sync_playwright

mpl.use("agg")
import matplotlib.pyplot as plt

from sawmill_worker import demo, examples
from sawmill_worker.demo_client import running_service
from sawmill_worker.storage.settings import StorageSettings
from sawmill_worker.storage.store import Store
from sawmill_worker.tomography.fbp import fbp
from sawmill_worker.tomography.geometry import FanBeamGeometry, Theta, to_vector
from sawmill_worker.tomography.image_grid import ImageGrid
from sawmill_worker.tomography.projector import Projector

PICTURES = Path(__file__).parents[1] / "docs/pictures"
LARGEST_BYTES = 150_000
COLOURS = 48
FLAGS = ("--no-sandbox", "--disable-gpu", "--disable-background-networking", "--force-color-profile=srgb")
LANGUAGES = {"": "en-GB", ".fi": "fi-FI"}
CAPTIONS = {"": ("measured by tape", "calibrated"), ".fi": ("mittanauhalla mitattu", "kalibroitu")}


@dataclass(frozen=True)
class Shot:
    """A page at a width; `scanner` is the place in the list of lines whose id fills the path."""

    name: str
    path: str
    width: int = 1000
    height: int = 640
    scanner: int = 0


SHOTS = (
    Shot("today", "/"),
    Shot("phantom", "/phantoms/l-shape"),
)


def main() -> int:
    """Draw what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, help="the data folder to keep, or to take")
    parser.add_argument("--only", help="one picture by its name")
    asked = parser.parse_args()
    PICTURES.mkdir(exist_ok=True)
    if asked.only in {None, "before-after"}:
        images = before_after()
        for suffix, captions in CAPTIONS.items():
            save(drawn_side_by_side(images, captions), f"before-after{suffix}")
    shots = [shot for shot in SHOTS if asked.only in {None, shot.name}]
    if not shots:
        return 0
    with mill(asked.data) as (folder, scanner_ids), running_service(folder) as client, chromium() as browser:
        for shot in shots:
            for suffix, language in LANGUAGES.items():
                save(photograph(browser, client, shot, scanner_ids, language), f"{shot.name}{suffix}")
    return 0


@contextmanager
def mill(kept: Path | None) -> Iterator[tuple[Path, Sequence[str]]]:
    """A folder whose `data` has a mill's history, and its scanners' ids in their order."""
    with tempfile.TemporaryDirectory(prefix="sawmill-mill-") as temporary:
        folder = kept or Path(temporary)
        settings, clock = StorageSettings(data_folder=folder / "data", database_url=None), PastClock()
        with closing(Store.open(settings, clock=clock)) as store:
            known = [scanner.id for scanner in reversed(store.scanners.page().items)]
            ids = known or write_history(store, clock)
        yield folder, ids


@contextmanager
def chromium() -> Iterator[Browser]:
    """Debian's browser."""
    program = shutil.which("chromium")
    if program is None:
        sys.exit("the pictures need Debian's Chromium: apt-get install chromium")
    with (
        sync_playwright() as playwright,
        closing(playwright.chromium.launch(executable_path=program, args=FLAGS)) as browser,
    ):
        yield browser


def photograph(
    browser: Browser, client: httpx.Client, shot: Shot, scanner_ids: Sequence[str], language: str
) -> Image.Image:
    """One page in one language, light."""
    context = browser.new_context(
        base_url=str(client.base_url),
        viewport={"width": shot.width, "height": shot.height},
        locale=language,
        color_scheme="light",
        timezone_id="UTC",
    )
    with closing(context):
        page: Page = context.new_page()
        page.goto(shot.path.format(scanner_id=scanner_ids[shot.scanner]))
        page.wait_for_load_state("load")
        return Image.open(io.BytesIO(page.screenshot(animations="disabled")))


def before_after() -> list[NDArray[np.float32]]:
    """One scan of a log, reconstructed (x, y) with what a tape measure gives, and with the true geometry."""
    size, field_mm, views = 420, 300.0, 360
    log = examples.mill_slices()[examples.PHANTOM_ROWS]
    angles = examples.full_turn(views)
    stack = examples.mill_stack(views, [log])
    air, dark = stack.flats.mean(axis=0)[0] - stack.darks.mean(), stack.darks.mean()
    sinogram = -np.log(np.maximum(stack.counts[:, 0] - dark, 1.0) / air)
    taped = Theta.from_vector(to_vector(examples.THETA) + to_vector(demo.TAPE_ERROR))
    images = []
    for theta in (taped, examples.THETA):
        geometry = FanBeamGeometry(examples.SCANNER, theta, angles)
        images.append(fbp(Projector(geometry, ImageGrid(size, field_mm)), sinogram).image)
    return images


def drawn_side_by_side(images: Sequence[NDArray[np.float32]], captions: tuple[str, str]) -> Image.Image:
    """In one grey window, from a tenth of the heartwood's value to what a knot has, each with a caption."""
    half = images[-1].shape[0] // 2
    wood = float(np.median(images[-1][half - 80 : half + 80, half - 80 : half + 80]))
    figure, panels = plt.subplots(1, 2, figsize=(8.8, 4.7), layout="constrained", facecolor="white")
    for panel, image, caption in zip(panels, images, captions, strict=True):
        panel.imshow(image, cmap="gray", vmin=0.1 * wood, vmax=2.2 * wood)
        panel.set_title(caption, fontsize=16)
        panel.axis("off")
    stream = io.BytesIO()
    figure.savefig(stream, format="png", dpi=100)
    plt.close(figure)
    return Image.open(stream)


def save(picture: Image.Image, name: str) -> None:
    """As a PNG with a palette, which must be small."""
    path = PICTURES / f"{name}.png"
    picture.convert("RGB").quantize(COLOURS, method=Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE).save(
        path, optimize=True
    )
    size = path.stat().st_size
    print(f"{path.name}: {picture.width} x {picture.height}, {size / 1e3:.0f} kB", flush=True)
    if size > LARGEST_BYTES:
        sys.exit(f"{path.name} has {size} bytes, more than {LARGEST_BYTES}")


if __name__ == "__main__":
    sys.exit(main())
