"""The pictures of docs/understand/measured.md and the outputs of examples/measured-disc.ipynb, from one measured disc.

    python docs/tools/measured_pictures.py [--only NAME ...]

The disc is one of those that `measured_discs.py` reads.

Dataset: A. Meaney, F. Silva de Moura, S. Siltanen, Helsinki Tomography Challenge 2022 open tomographic dataset,
University of Helsinki, CC BY 4.0.
"""

import argparse
import io
import os
import sys
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from notebooks import MEASURED, run_and_keep
from PIL import Image
from scipy.ndimage import binary_erosion
from screenshots import save

import sawmill_calibration as sawmill
from sawmill_calibration.pictures.panels import draw_phantom, show_image

sys.path.append(str(Path(__file__).parents[2] / "benchmarks"))
from measured import DISC_RADIUS_MM, RADIUS_MM, SIZE, acrylic_of, image_of
from measured_discs import OUTLINE_WIDTH_MM, VIEWS, Disc, discs_folder, read_discs

# The one with the most holes of those with all views.
DISC = "07b"
CALIBRATED_VIEWS = 90
FEW_VIEWS = (20, 45, 90, VIEWS)
# Sizes of palettes. Eight images of noise need few colours to be small.
COLOURS, GREYS = 160, 48


def main() -> None:
    """Draw the pictures and run the notebook."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    made: Mapping[str, Callable[[Disc], None]] = {
        "sinogram": lambda disc: keep(disc.scan(VIEWS).plot(), "measured-sinogram"),
        "outline": lambda disc: keep(outline(disc), "measured-outline"),
        "few-views": lambda disc: keep(few_views(disc), "measured-few-views", GREYS),
        "hardening": lambda disc: keep(hardening(disc), "measured-hardening"),
        "notebook": run_notebook,
    }
    parser.add_argument("--only", nargs="+", choices=made, default=list(made), metavar="NAME", help=", ".join(made))
    chosen = parser.parse_args().only
    (disc,) = (each for each in read_discs(discs_folder()) if each.name == DISC)
    for name in chosen:
        made[name](disc)


def keep(figure: Figure, name: str, colours: int = COLOURS) -> None:
    """Write a figure as a small PNG in docs/pictures."""
    stream = io.BytesIO()
    figure.savefig(stream, format="png", dpi=80)
    save(Image.open(stream), name, colours)


def calibration_of(disc: Disc) -> sawmill.Calibration:
    """Calibrate with the disc's outline."""
    return sawmill.calibrate(disc.scan(CALIBRATED_VIEWS), disc.outline, phantom_width_mm=OUTLINE_WIDTH_MM)


def outline(disc: Disc) -> Figure:
    """Draw the disc by FBP with the geometry that was found from it, its outline where the calibration put it."""
    found = calibration_of(disc)
    assert found.arrays is not None
    arrays = found.arrays()
    figure = Figure(figsize=(6.8, 5.8), layout="constrained")
    outlines = arrays.phantom_outlines_mm
    draw_phantom(figure, figure.add_subplot(), arrays.phantom_image, arrays.phantom_field_mm, outlines)
    return figure


def few_views(disc: Disc) -> Figure:
    """Draw FBP above total variation, from few views on the left to all on the right, in one grey window."""
    window = (0.0, 1.15 * float(np.percentile(image_of(disc, VIEWS, "fbp"), 95.0)))
    figure = Figure(figsize=(12.0, 6.2), layout="constrained")
    panels = figure.subplots(2, len(FEW_VIEWS), sharex=True, sharey=True)
    for row, method in zip(panels, ("fbp", "total_variation"), strict=True):
        for ax, views in zip(row, FEW_VIEWS, strict=True):
            show_image(ax, image_of(disc, views, method), OUTLINE_WIDTH_MM, window)
            ax.set_title(f"{method}, {views} views")
            ax.label_outer()
    return figure


def hardening(disc: Disc) -> Figure:
    """Draw FBP of all views without and with the estimated hardening, and the acrylic by its radius."""
    calibration, acrylic = calibration_of(disc), binary_erosion(acrylic_of(disc), iterations=3)
    images = {
        title: sawmill.reconstruct(
            disc.scan(VIEWS), calibration, hardening=choice, size=SIZE, field_mm=OUTLINE_WIDTH_MM
        ).image
        for title, choice in (("as measured", "none"), ("hardening taken out", "auto"))
    }
    figure = Figure(figsize=(12.0, 3.9), layout="constrained")
    *panels, profile = figure.subplots(1, 3)
    rings = np.arange(0.0, DISC_RADIUS_MM, 1.0)
    for ax, (title, image) in zip(panels, images.items(), strict=True):
        show_image(ax, image, OUTLINE_WIDTH_MM, (0.0, 1.1 * float(np.percentile(image, 95.0))))
        ax.set_title(title)
        ring = [image[acrylic & (abs(RADIUS_MM - radius) < 0.5)] for radius in rings]
        profile.plot(rings, [values.mean() if len(values) else np.nan for values in ring], label=title)
    profile.set_ylim(bottom=0.0)
    profile.set(xlabel="distance from the axis, mm", title="mean of the acrylic, 1/mm")
    profile.legend(loc="lower left")
    return figure


def run_notebook(_: Disc) -> None:
    """Run the notebook from the first cell to the last and keep its outputs in it."""
    os.environ.setdefault("SAWMILL_PUBLISHED_DATA", str(discs_folder().parent.resolve()))
    run_and_keep(MEASURED)


if __name__ == "__main__":
    main()
