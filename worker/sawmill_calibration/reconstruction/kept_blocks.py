"""Finished blocks of a volume, kept in stored form and written unchanged into the next attempt's file."""

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from threading import Lock
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sawmill_calibration.checkpoints import Keeper
from sawmill_calibration.reconstruction.block_solvers import BlockSolver, Images, Settings
from sawmill_calibration.reconstruction.method_findings import BlockFindings, CurvePoints, MetalCount
from sawmill_contracts.reasons import CodedReason
from sawmill_formats.output.volume_writer import NewVolume, PackedSlices

SETTINGS = "settings"


@dataclass(frozen=True, eq=False)
class FinishedBlock:
    """Data for the report from a written block: sampled values, findings, and the fewest views of a slice."""

    sample: NDArray[np.float32]
    findings: BlockFindings
    fewest_views: int


def settings_of(keeper: Keeper) -> Settings | None:
    """Return the settings that an earlier attempt at the volume had chosen."""
    kept = keeper.kept(SETTINGS)
    return None if kept is None else _parsed(kept[SETTINGS])


def keep_settings(keeper: Keeper, settings: Settings) -> None:
    """Keep the settings that were chosen for all blocks."""
    keeper.keep(SETTINGS, {SETTINGS: _text(settings)})


class KeptVolume:
    """A volume that is being written, from any thread; its blocks are also kept once the job has taken long enough."""

    def __init__(self, volume: NewVolume, solver: BlockSolver, keeper: Keeper, kept_settings: Settings | None) -> None:
        self._volume, self._solver, self._keeper = volume, solver, keeper
        self._kept_settings = kept_settings
        self._keeping_settings = Lock()

    def take_up(self, first: int) -> FinishedBlock | None:
        """Write the block that begins with slice `first`, if an earlier attempt finished it with the same settings."""
        kept = self._keeper.kept(_name(first), self._solver.settings)
        if kept is None:
            return None
        self._volume.write_packed(first, PackedSlices.from_arrays(kept))
        return FinishedBlock(kept["sample"], _findings(_parsed(kept["findings"])), int(kept["fewest_views"]))

    def write(self, first: int, images: Images, block: FinishedBlock) -> None:
        """Write a block (slices, x, y) and, in a long job, keep the block."""
        slices = PackedSlices.of(images)
        self._volume.write_packed(first, slices)
        if self._keeper.has_begun:
            self._keep(first, slices, block)

    def _keep(self, first: int, slices: PackedSlices, block: FinishedBlock) -> None:
        with self._keeping_settings:
            settings = self._solver.settings
            if settings != self._kept_settings:
                keep_settings(self._keeper, settings)
                self._kept_settings = settings
        remarks = [CodedReason.of(remark).model_dump(mode="json") for remark in block.findings.remarks]
        summary: dict[str, NDArray[Any]] = {
            "sample": block.sample,
            "findings": _text({**asdict(block.findings), "remarks": remarks}),
            "fewest_views": np.array(block.fewest_views),
        }
        self._keeper.keep(_name(first), {**slices.arrays(), **summary}, settings)


def _name(first: int) -> str:
    return f"slices-{first:08d}"


def _text(value: Mapping[str, Any]) -> NDArray[np.uint8]:
    return np.frombuffer(json.dumps(value).encode(), np.uint8)


def _parsed(text: NDArray[np.uint8]) -> dict[str, Any]:
    parsed: dict[str, Any] = json.loads(text.tobytes())
    return parsed


def _findings(parsed: dict[str, Any]) -> BlockFindings:
    metal, curve = MetalCount(**parsed.pop("metal")), parsed.pop("curve")
    remarks = [CodedReason.model_validate(each).text for each in parsed.pop("remarks")]
    return BlockFindings(**parsed, remarks=remarks, metal=metal, curve=None if curve is None else CurvePoints(**curve))
