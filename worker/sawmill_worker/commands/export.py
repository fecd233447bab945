"""`sawmill export`: a calibrated geometry for another toolkit."""

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from types import MappingProxyType

import numpy as np

from sawmill_calibration.calibration.result_file import read_calibration
from sawmill_calibration.failures import refused
from sawmill_formats.input.angles import AnglesGiven
from sawmill_formats.output.rtk_xml import rtk_xml
from sawmill_tomography.geometry.export import cil_arguments, odl_arguments, rtk_geometry
from sawmill_tomography.geometry.geometry import FanBeamGeometry, cell_centres_mm
from sawmill_worker.commands.options import ExportTarget


def export_geometry(target: ExportTarget, calibration: Path, output: Path, angles: AnglesGiven, views: int) -> None:
    """Write a calibration's geometry at the given views for a toolkit; none of them knows a detector of modules."""
    result = read_calibration(calibration)
    if result.scanner.detector_modules:
        cells = ", ".join(str(module.first_cell) for module in result.scanner.detector_modules)
        raise refused(
            "contradiction",
            f"the calibration is of a detector of modules, which meet at cell {cells}, and {target} knows one straight "
            "line of cells: reconstruct with sawmill reconstruct, or calibrate --without modules",
        )
    turned = result.rotation.apply(np.deg2rad(angles.expand(views)))
    _WRITERS[target](output, FanBeamGeometry(result.scanner, result.theta, turned))


def _write_for_astra(output: Path, fan: FanBeamGeometry) -> None:
    """Write a row per view, in the form of ASTRA's `fanflat_vec`."""
    header = f"astra fanflat_vec, mm: srcX srcY dX dY uX uY; {fan.scanner.num_detector_pixels} cells"
    np.savetxt(output, fan.astra_vectors(), fmt="%.12g", header=header)


def _write_for_odl(output: Path, fan: FanBeamGeometry) -> None:
    output.write_text(json.dumps(odl_arguments(fan), indent=1) + "\n", encoding="utf-8")


def _write_for_cil(output: Path, fan: FanBeamGeometry) -> None:
    output.write_text(json.dumps(cil_arguments(fan), indent=1) + "\n", encoding="utf-8")


def _write_for_rtk(output: Path, fan: FanBeamGeometry) -> None:
    scanner = fan.scanner
    pitch, origin = scanner.detector_pitch_mm, float(cell_centres_mm(scanner)[0])
    remark = f"projections: {scanner.num_detector_pixels} cells, spacing {pitch!r} mm, origin {origin!r} mm"
    output.write_text(rtk_xml(**vars(rtk_geometry(fan)), remark=remark), encoding="utf-8")


_WRITERS: Mapping[ExportTarget, Callable[[Path, FanBeamGeometry], None]] = MappingProxyType(
    {
        ExportTarget.ASTRA: _write_for_astra,
        ExportTarget.ODL: _write_for_odl,
        ExportTarget.CIL: _write_for_cil,
        ExportTarget.RTK: _write_for_rtk,
    }
)
