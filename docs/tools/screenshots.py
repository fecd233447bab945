"""The pictures in docs/pictures: the pages as Chromium shows them, and one log before and after its calibration.

    make screenshots
    python docs/tools/screenshots.py [--data FOLDER] [--only NAME]

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
from mill_history import LINES, PastClock, write_history
from numpy.typing import NDArray
from PIL import Image
from playwright.sync_api import Browser, sync_playwright

mpl.use("agg")
import matplotlib.pyplot as plt

import sawmill_calibration as sawmill
from sawmill_command import demo, examples
from sawmill_command.demo_client import running_service
from sawmill_platform.settings import StorageSettings
from sawmill_store.store import Store
from sawmill_tomography.geometry.geometry import FanBeamGeometry, Theta, to_vector
from sawmill_tomography.geometry.image_grid import ImageGrid
from sawmill_tomography.geometry.ray_error import ray_error
from sawmill_tomography.projection.projector import Projector
from sawmill_tomography.reconstruction.fbp import fbp

PICTURES = Path(__file__).parents[1] / "pictures"
LARGEST_BYTES = 150_000
# A script draws what it has fetched.
SETTLED_MS = 6000
FLAGS = ("--no-sandbox", "--disable-gpu", "--disable-background-networking", "--force-color-profile=srgb")
LANGUAGES = {"": "en-GB", ".fi": "fi-FI"}
GOOD, WATCHED, MOVED = (line.name for line in LINES[:3])
# With the RMS error of the rays, mm.
CAPTIONS = {
    "": ("tape measure: rays {} mm off", "calibrated: rays {} mm off"),
    ".fi": ("rullamitta: säteet {} mm sivussa", "kalibroitu: säteet {} mm sivussa"),
}


@dataclass(frozen=True)
class Shot:
    """A page at a size, of one of the lines by its name.

    `finnish` asks for a twin in that language; `part` is the element that is shown, if not what the window shows.
    """

    name: str
    path: str
    width: int = 1000
    height: int = 700
    line: str = GOOD
    finnish: bool = False
    part: str = "body"


SHOTS = (
    Shot("today", "/", height=970, finnish=True),
    Shot("scanner", "/scanners/{scanner}", height=1000, line=MOVED, finnish=True),
    Shot(
        "verdict",
        "/calibrate?scanner={scanner}&calibration={calibration}",
        height=1210,
        line=WATCHED,
        finnish=True,
    ),
    Shot("drift", "/scanners/{scanner}?days=90", line=WATCHED, part="section[aria-labelledby=drift]"),
    Shot("phantom", "/phantoms/l-shape"),
    Shot("viewer", "/logs/{reconstruction}"),
    Shot("report", "/calibrations/{calibration}/report", width=820, height=1160),
)


def main() -> int:
    """Draw the requested pictures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, help="the data folder to keep, or to take")
    parser.add_argument("--only", help="one picture by its name")
    asked = parser.parse_args()
    PICTURES.mkdir(exist_ok=True)
    if asked.only in {None, "before-after"}:
        images, errors_mm = before_after()
        for suffix, captions in CAPTIONS.items():
            mark = "," if suffix else "."
            numbers = (f"{error_mm:.2g}".replace(".", mark) for error_mm in errors_mm)
            titled = [caption.format(number) for caption, number in zip(captions, numbers, strict=True)]
            save(drawn_side_by_side(images, titled), f"before-after{suffix}", 48, Image.Quantize.MAXCOVERAGE)
    shots = [shot for shot in SHOTS if asked.only in {None, shot.name}]
    if not shots:
        return 0
    with mill(asked.data) as (folder, scanner_ids), running_service(folder) as client, chromium() as browser:
        for shot in shots:
            path = shot.path.format_map(Ids(client, scanner_ids[shot.line]))
            for suffix, language in LANGUAGES.items():
                if shot.finnish or not suffix:
                    save(photograph(browser, f"{client.base_url}{path}", shot, language), f"{shot.name}{suffix}")
    return 0


@dataclass(frozen=True)
class Ids:
    """Ids by the names in a shot's path: the newest of a line's."""

    client: httpx.Client
    scanner_id: str

    def __getitem__(self, name: str) -> str:
        """Return the scanner's id, or the id of the newest object of a kind."""
        if name == "scanner":
            return self.scanner_id
        listed = self.client.get(f"/v1/{name}s", params={"scanner_id": self.scanner_id, "limit": 1})
        return str(listed.raise_for_status().json()["items"][0]["id"])


@contextmanager
def mill(kept: Path | None) -> Iterator[tuple[Path, dict[str, str]]]:
    """Yield a folder whose `data` has a mill's history, and its scanners' ids by their names."""
    with tempfile.TemporaryDirectory(prefix="sawmill-mill-") as temporary:
        folder = kept or Path(temporary)
        settings, clock = StorageSettings(data_folder=folder / "data", database_url=None), PastClock()
        with closing(Store.open(settings, clock=clock)) as store:
            if not store.scanners.page().items:
                write_history(store, clock)
            ids = {scanner.name: scanner.id for scanner in store.scanners.page().items}
        yield folder, ids


@contextmanager
def chromium() -> Iterator[Browser]:
    """Start Debian's browser."""
    program = shutil.which("chromium")
    if program is None:
        sys.exit("the pictures need Debian's Chromium: apt-get install chromium")
    with (
        sync_playwright() as playwright,
        closing(playwright.chromium.launch(executable_path=program, args=FLAGS)) as browser,
    ):
        yield browser


def photograph(browser: Browser, address: str, shot: Shot, language: str) -> Image.Image:
    """Photograph one page in one language, light."""
    context = browser.new_context(
        viewport={"width": shot.width, "height": shot.height}, locale=language, color_scheme="light", timezone_id="UTC"
    )
    with closing(context):
        page = context.new_page()
        answered = page.goto(address)
        if answered is None or not answered.ok:
            sys.exit(f"{address} has no page to be shown")
        page.wait_for_load_state("load")
        page.wait_for_timeout(SETTLED_MS)
        whole = shot.part == "body"
        taken = page.screenshot(animations="disabled") if whole else page.locator(shot.part).screenshot()
        return Image.open(io.BytesIO(taken))


def before_after() -> tuple[list[NDArray[np.float32]], list[float]]:
    """Reconstruct one scan of a log (x, y) with the geometry by tape measure, and with the calibrated one.

    Returns the two images and the RMS ray errors of the two geometries, mm.
    The calibration is by the phantom on the log's end, a row of the same scan.
    """
    size, field_mm, views = 420, 300.0, 360
    phantom_and_log = examples.mill_slices()[examples.PHANTOM_ROWS - 1 : examples.PHANTOM_ROWS + 1]
    angles = examples.full_turn(views)
    stack = examples.mill_stack(views, phantom_and_log)
    dark = stack.darks.mean()
    lines = -np.log(np.maximum(stack.counts - dark, 1.0) / (stack.flats.mean(axis=0) - dark))
    scan = sawmill.Scan.from_arrays(lines[:, :1], angles, examples.SCANNER, from_counts=True)
    taped = Theta.from_vector(to_vector(examples.THETA) + to_vector(demo.TAPE_ERROR))
    true = examples.THETA.source_frame(examples.SCANNER.source_to_cor_mm)
    images, errors_mm = [], []
    for theta in (taped, sawmill.calibrate(scan, "l-shape").theta):
        geometry = FanBeamGeometry(examples.SCANNER, theta, angles)
        images.append(fbp(Projector(geometry, ImageGrid(size, field_mm)), lines[:, 1]).image)
        frame = theta.source_frame(examples.SCANNER.source_to_cor_mm)
        errors_mm.append(ray_error(examples.SCANNER, true, frame).rms_mm)
    return images, errors_mm


def drawn_side_by_side(images: Sequence[NDArray[np.float32]], captions: Sequence[str]) -> Image.Image:
    """Draw images in one grey window, from a tenth of the heartwood's value to a knot's, each with a caption."""
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


def save(
    picture: Image.Image, name: str, colours: int = 240, method: Image.Quantize = Image.Quantize.MAXCOVERAGE
) -> None:
    """Save a picture as a PNG with a palette, which must be small."""
    path = PICTURES / f"{name}.png"
    picture.convert("RGB").quantize(colours, method=method, dither=Image.Dither.NONE).save(path, optimize=True)
    size = path.stat().st_size
    print(f"{path.name}: {picture.width} x {picture.height}, {size / 1e3:.0f} kB", flush=True)
    if size > LARGEST_BYTES:
        sys.exit(f"{path.name} has {size} bytes, more than {LARGEST_BYTES}")


if __name__ == "__main__":
    sys.exit(main())
