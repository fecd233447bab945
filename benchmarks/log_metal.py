"""Nails in logs: what the treatment of metal gains, by method and number of views. Simulated counts, ten flats.

    python benchmarks/log_metal.py [--logs 5] [--seed 1] [--size 256] [--views 12 20 45 180 360]
                                   [--methods fbp total_variation]

Log n has n mod 5 + 1 nails: discs of 1 to 3 mm radius, one in five at the bark, that attenuate 15 to 25 times more than
the wood. For each method the relative error outside the metal, and SSIM, of images with `metal: none`, with `auto`, and
of the same log without its nails; then the nails found, and false alarms in logs without metal.
"""

import argparse
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scanners import SCANNER
from scans import TRUE_THETA
from scipy.ndimage import binary_dilation, label

from sawmill_contracts.geometry import ScannerConstants
from sawmill_contracts.reconstructions import ReconstructionOptions
from sawmill_tomography.geometry.geometry import TAU, FanBeamGeometry
from sawmill_tomography.phantoms.log_model import LogModel
from sawmill_tomography.phantoms.phantom import Disc, Phantom
from sawmill_tomography.preparing.line_integrals import line_integrals
from sawmill_tomography.projection.projector import Image
from sawmill_tomography.projection.simulate import simulate_stack
from sawmill_tomography.reconstruction.metal import MetalSearch
from sawmill_tomography.reconstruction.object_extent import object_radius_mm
from sawmill_tomography.reconstruction.quality import relative_error, structural_similarity_index
from sawmill_vocabulary import Handedness, MetalHandling, ReconstructionMethod, Rotation
from sawmill_worker.use_cases.reconstruction.reconstruct import ReconstructionInput, reconstruct_in_memory

FIELD_MM = 320.0


@dataclass(frozen=True, eq=False)
class NailedLog:
    """A log with nails and the same one without."""

    nailed: Phantom
    plain: Phantom
    nails: int
    photons: float

    @classmethod
    def random(cls, seed: int, number: int) -> "NailedLog":
        """Draw log `number` of a study."""
        rng = np.random.default_rng([seed, number])
        radius = rng.uniform(90.0, 140.0)
        log = LogModel.random(1000 * seed + number, radius_mm=radius)
        plain = log.slice_at(rng.uniform(40.0, 120.0)).moved(*rng.uniform(-8.0, 8.0, 2))
        nails = number % 5 + 1
        depth = np.where(rng.uniform(size=nails) < 0.2, 0.98, rng.uniform(0.2, 0.95, nails)) * radius
        turn = rng.uniform(0.0, TAU, nails)
        discs = tuple(
            Disc((d * np.cos(t), d * np.sin(t)), rng.uniform(1.0, 3.0), rng.uniform(0.25, 0.35))
            for d, t in zip(depth, turn, strict=True)
        )
        return cls(
            Phantom("nailed", (*plain.shapes, *discs)),
            plain,
            nails,
            float(np.exp(rng.uniform(np.log(5e3), np.log(5e4)))),
        )

    def scan(self, body: Phantom, fan: FanBeamGeometry, seed: int) -> Image:
        """Simulate line integrals (views, cells) from counts with ten flats."""
        stack = simulate_stack([body], fan, photons=self.photons, seed=seed)
        counts, flats, darks = (frames.astype(np.float32) for frames in vars(stack).values())
        return line_integrals(counts, flats, darks).stack[:, 0]


def image_of(
    lines: Image, fan: FanBeamGeometry, method: ReconstructionMethod, metal: MetalHandling, size: int
) -> Image:
    """Reconstruct a slice (size, size) as the command does."""
    given = ReconstructionInput(
        read=lambda start, stop: lines[:, None][:, start:stop],
        angles_rad=fan.angles_rad,
        rows=(0, 1),
        scanner=ScannerConstants(**vars(SCANNER)),
        theta=TRUE_THETA,
        rotation=Rotation.AS_GIVEN,
        handedness=Handedness.AS_DRAWN,
        input_sha256="0" * 64,
        counts=True,
    )
    options = ReconstructionOptions(method=method, size=size, field_mm=FIELD_MM, metal=metal)
    return reconstruct_in_memory(given, options, lambda _: None).data[0]


def quality(image: Image, truth: Image, wood: NDArray[np.bool_]) -> tuple[float, float]:
    """Compute relative error and SSIM outside the metal."""
    return relative_error(image[wood], truth[wood]), structural_similarity_index(np.where(wood, image, truth), truth)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--logs", type=int, default=5)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--size", type=int, default=160)
    parser.add_argument("--views", type=int, nargs="+", default=[12, 20, 45, 180, 360])
    parser.add_argument("--methods", nargs="+", default=["fbp", "tikhonov", "total_variation", "cauchy_map"])
    asked = parser.parse_args()
    print(f"{asked.logs} logs, seed {asked.seed}, {asked.size} pixels: mean relative error (SSIM) outside the metal")
    for views in asked.views:
        fan = FanBeamGeometry(SCANNER, TRUE_THETA, (np.arange(views) + 0.5) * TAU / views)
        found: dict[str, list[list[tuple[float, float]]]] = {method: [] for method in asked.methods}
        nails = right = false_alarms = 0
        for number in range(asked.logs):
            log = NailedLog.random(asked.seed, number)
            lines, clean = (log.scan(body, fan, number) for body in (log.nailed, log.plain))
            nailed, truth = (body.rasterise(asked.size, FIELD_MM) for body in (log.nailed, log.plain))
            wood = ~binary_dilation(nailed - truth > 0.0)
            search = MetalSearch.of(fan, object_radius_mm(fan, lines))
            assert search is not None
            metal = search.find(lines) if search.suspects(lines[None])[0] else None
            nails, right = nails + log.nails, right + (0 if metal is None else label(metal.excess > 0)[1])
            false_alarms += int(search.suspects(clean[None])[0] and search.find(clean) is not None)
            for method in asked.methods:
                cases = ((lines, MetalHandling.NONE), (lines, MetalHandling.AUTO), (clean, MetalHandling.NONE))
                images = (image_of(data, fan, ReconstructionMethod(method), metal, asked.size) for data, metal in cases)
                found[method].append([quality(image, truth, wood) for image in images])
        print(f"{views} views: {right} pieces found of {nails} nails, {false_alarms} false alarms", flush=True)
        for method, rows in found.items():
            means = np.mean(rows, axis=0)
            print(
                f"  {method:16s}"
                + "  ".join(
                    f"{name} {error:.3f} ({ssim:.2f})"
                    for name, (error, ssim) in zip(("as it is", "treated", "no nails"), means, strict=True)
                ),
                flush=True,
            )


if __name__ == "__main__":
    main()
