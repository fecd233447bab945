"""The measured discs of docs/understand/measured.md: read here, and converted from the files as they are published.

    python benchmarks/measured_discs.py PUBLISHED FOLDER

PUBLISHED has htc2022_NAME_full.mat and htc2022_NAME_...seg.png of doi 10.5281/zenodo.7418878, in any folders below it.
FOLDER gets NAME-720views.npz, outlines/NAME.png and independent.json. Call it measured-discs, and let
SAWMILL_PUBLISHED_DATA name the folder that it is in.

Dataset: A. Meaney, F. Silva de Moura, S. Siltanen, Helsinki Tomography Challenge 2022 open tomographic dataset,
University of Helsinki, CC BY 4.0.
"""

import argparse
import json
import math
import os
import shutil
import sys
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from opposite_ray_fit import Independent, opposite_ray_fit
from rich.progress import track
from scipy.io import loadmat

import sawmill_calibration as sawmill
from sawmill_vocabulary import SourceFrame

DOI = "10.5281/zenodo.7418878"
CITATION = "A. Meaney, F. Silva de Moura, S. Siltanen, Helsinki Tomography Challenge 2022, CC BY 4.0"
SCANNER = sawmill.Scanner(source_to_cor_mm=410.66, num_detector_pixels=560, detector_pitch_mm=0.2)
SOURCE_TO_DETECTOR_MM = 553.74
OUTLINE_WIDTH_MM = 75.94
# The published turn ends with a second view at 0 degrees, which is left out.
VIEWS, STEP_DEG = 720, 0.5
SOLID = "solid_disc"
# Every eighth view of several discs, in one file.
FEW_VIEWS = "discs-90views.npz"
FULL_TURN = "-720views.npz"


@dataclass(frozen=True)
class Disc:
    """A disc: a full turn of equal steps, its outline, and its independently measured COR and tilt."""

    name: str
    sinogram: NDArray[np.float32]
    outline: Path
    independent: Independent

    @property
    def views(self) -> int:
        """Number of views that are here: 720, or every eighth of them."""
        return len(self.sinogram)

    def scan(self, views: int, start: int = 0) -> sawmill.Scan:
        """Return every (views here / views)-th view from `start` on."""
        step = self.views // views
        angles = np.arange(start, self.views, step) * math.tau / self.views
        return sawmill.Scan.from_arrays(self.sinogram[start::step], angles, SCANNER)

    @property
    def frame(self) -> SourceFrame:
        """The laboratory's distances, with the independent COR and tilt; x and y are the outline's."""
        known = self.independent
        return nominal_frame(known.cor_column_mm, math.radians(known.tilt_deg))


def nominal_frame(cor_column_mm: float = 0.0, tilt_rad: float = 0.0) -> SourceFrame:
    """Return the laboratory's distances; at angle 0 the source lies on -x of the outlines."""
    return SourceFrame(math.pi / 2, SCANNER.source_to_cor_mm, SOURCE_TO_DETECTOR_MM, cor_column_mm, tilt_rad)


def discs_folder() -> Path:
    """Return the folder with the discs, or end the program with a sentence where there is none."""
    folder = Path(os.environ.get("SAWMILL_PUBLISHED_DATA", "../shared/data")) / "measured-discs"
    if not (folder / "independent.json").is_file():
        sys.exit(
            f"There are no measured discs in {folder}: get htc2022_*_full.mat and the segmentations of doi {DOI}, "
            f"convert them (python benchmarks/measured_discs.py PUBLISHED {folder}), or let SAWMILL_PUBLISHED_DATA "
            "name the folder that has measured-discs."
        )
    return folder


def read_discs(folder: Path) -> list[Disc]:
    """Read the discs of a converted folder, in the order of independent.json."""
    sinograms: dict[str, NDArray[np.float32]] = {}
    if (folder / FEW_VIEWS).is_file():
        with np.load(folder / FEW_VIEWS, allow_pickle=False) as few:
            sinograms |= dict(zip(few["names"].tolist(), few["sinograms"], strict=True))
    for path in folder.glob(f"*{FULL_TURN}"):
        with np.load(path, allow_pickle=False) as full:
            sinograms[path.name.removesuffix(FULL_TURN)] = full["projections"]
    independent = json.loads((folder / "independent.json").read_text())
    names = Independent.__dataclass_fields__
    return [
        Disc(
            name,
            sinograms[name],
            folder / "outlines" / f"{name}.png",
            Independent(**{key: value for key, value in known.items() if key in names}),
        )
        for name, known in independent.items()
    ]


def convert(published: Path, folder: Path) -> None:
    """Write the folder that `read_discs` reads, or end the program with a sentence that names what is wrong."""
    scans = {
        path.name.split("_", 1)[1].removesuffix("_full.mat"): path for path in published.rglob("htc2022_*_full.mat")
    }
    if not scans:
        sys.exit(f"There is no htc2022_*_full.mat in {published} or below: they are published as doi {DOI}.")
    (folder / "outlines").mkdir(parents=True, exist_ok=True)
    independent = {}
    for name, path in track(sorted(scans.items()), description="Converting"):
        sinogram = published_sinogram(path)
        outlines = sorted(published.rglob(f"htc2022_{name}_*seg.png"))
        if not outlines:
            sys.exit(f"There is no segmentation htc2022_{name}_*seg.png in {published} or below, as {path.name} needs.")
        angles_deg = np.arange(VIEWS) * STEP_DEG
        np.savez_compressed(folder / f"{name}{FULL_TURN}", projections=sinogram, angles_deg=angles_deg)
        shutil.copyfile(outlines[0], folder / "outlines" / f"{name}.png")
        independent[name] = asdict(
            opposite_ray_fit(
                sinogram.astype(np.float64),
                pitch_mm=SCANNER.detector_pitch_mm,
                source_to_detector_mm=SOURCE_TO_DETECTOR_MM,
            )
        )
    (folder / "independent.json").write_text(json.dumps(independent, indent=1) + "\n")
    print(f"Converted: {len(independent)} discs, {folder}")


def published_sinogram(path: Path) -> NDArray[np.float32]:
    """Read the line integrals (720, 560) of a published file, or end with a sentence that names what is wrong."""
    try:
        struct = loadmat(path, simplify_cells=True)["CtDataFull"]
        sinogram, parameters = struct["sinogram"], struct["parameters"]
        found = (
            *sinogram.shape,
            *(parameters[name] for name in ("distanceSourceOrigin", "distanceSourceDetector", "pixelSizePost")),
        )
        angles_deg = np.ravel(parameters["angles"])
    except KeyError as error:
        sys.exit(f"{path.name} has no {error}: it is none of the files of doi {DOI}.")
    wanted = (
        *(VIEWS + 1, SCANNER.num_detector_pixels),
        *(SCANNER.source_to_cor_mm, SOURCE_TO_DETECTOR_MM, SCANNER.detector_pitch_mm),
    )
    if not np.allclose(found, wanted) or not np.array_equal(angles_deg, np.arange(VIEWS + 1) * STEP_DEG):
        sys.exit(
            f"{path.name} has views, cells, distances and pitch {found}, where {wanted} in steps of 0.5 deg are read."
        )
    return np.asarray(sinogram[:VIEWS], np.float32)


def main() -> None:
    """Convert the published files."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("published", type=Path, help="the folder with the published files")
    parser.add_argument("folder", type=Path, help="where the converted ones are written")
    chosen = parser.parse_args()
    convert(chosen.published, chosen.folder)


if __name__ == "__main__":
    main()
