"""Writing a reconstruction's volume with everything it was made from."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from worker.contracts.geometry import ScannerConstants
from worker.contracts.reconstructions import ReconstructionOptions, ReconstructionResult
from worker.formats.result_files import write_reconstruction


def write_volume(
    path: Path,
    volume: NDArray[np.float32],
    result: ReconstructionResult,
    options: ReconstructionOptions,
    scanner: ScannerConstants,
) -> None:
    """Write volume (slice, x, y) as HDF5."""
    write_reconstruction(
        path,
        volume,
        pixel_mm=result.pixel_mm,
        row_pitch_mm=scanner.row_pitch_mm,
        unit=result.unit,
        geometry={
            **scanner.model_dump(mode="json", exclude_none=True),
            **result.theta.model_dump(mode="json"),
            "rotation": result.rotation.value,
            "handedness": result.handedness.value,
        },
        parameters={
            **options.model_dump(mode="json", exclude_none=True),
            "views": result.views,
            "rows": f"{result.rows[0]}:{result.rows[1]}",
        },
        software_version=result.software_version,
        input_sha256=result.input_sha256,
    )
