"""`sawmill export`: a calibrated geometry for another toolkit."""

from collections.abc import Callable, Mapping
from pathlib import Path
from types import MappingProxyType

import numpy as np

from worker.commands.options import ExportTarget
from worker.commands.result_file import read_calibration
from worker.formats.angles import AnglesGiven
from worker.tasks.conversion import to_scanner, to_theta
from worker.tomography import geometry
from worker.tomography.geometry import FanBeamGeometry


def _write_for_astra(result_file: Path, output: Path, angles: AnglesGiven, views: int) -> None:
    """A row a view, as ASTRA's `fanflat_vec` wants them."""
    known = read_calibration(result_file)
    turned = geometry.Rotation(known.rotation).apply(np.deg2rad(angles.expand(views)))
    fan = FanBeamGeometry(to_scanner(known.scanner), to_theta(known.theta), turned)
    header = f"astra fanflat_vec, mm: srcX srcY dX dY uX uY; {known.scanner.num_detector_pixels} cells"
    np.savetxt(output, fan.astra_vectors(), fmt="%.12g", header=header)


WRITERS: Mapping[ExportTarget, Callable[[Path, Path, AnglesGiven, int], None]] = MappingProxyType(
    {ExportTarget.ASTRA: _write_for_astra}
)
