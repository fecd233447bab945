"""`sawmill export`: a calibrated geometry for another toolkit, such as RTK's geometry file, version 3."""

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from sawmill_calibration.failures import refused
from sawmill_calibration.result_file import read_calibration
from sawmill_calibration.view_vectors import vectors_of
from sawmill_formats.input.angles import AnglesGiven
from sawmill_tomography.geometry.detector_shape import FlatDetector, flat_borders_mm
from sawmill_tomography.geometry.export import cil_arguments, odl_arguments, rtk_arguments
from sawmill_tomography.geometry.geometry import FanBeamGeometry, FloatArray, cell_centres_mm
from sawmill_worker.commands.options import ExportTarget


def export_geometry(
    target: ExportTarget, calibration: Path, output: Path, angles: AnglesGiven, views: int, flat: Path | None = None
) -> None:
    """Write a calibration's geometry at the given views for a toolkit, or as vectors, which `--geometry` reads.

    With line integrals `flat`, (..., cells), they are resampled to the equal cells of a straight detector first.
    """
    result = read_calibration(calibration)
    turned = result.rotation.apply(np.deg2rad(angles.expand(views)))
    fan = FanBeamGeometry(result.scanner, result.theta, turned)
    if flat is not None:
        shape = FlatDetector.of(flat_borders_mm(fan.scanner, fan.frame), fan.scanner)
        np.save(f"{output}.flat.npy", shape.resampled(_line_integrals(flat, fan.scanner.num_detector_pixels)))
        fan = FanBeamGeometry(fan.scanner.with_equal_cells, fan.theta, turned)
    _WRITERS[target](output, fan)


def _line_integrals(path: Path, cells: int) -> FloatArray:
    """Read line integrals (..., cells)."""
    try:
        lines = np.load(path, allow_pickle=False)
    except (ValueError, EOFError):
        lines = None
    if not isinstance(lines, np.ndarray) or lines.shape[-1:] != (cells,) or lines.dtype.kind != "f":
        raise refused("other-detector", f"{path} must have {cells} cells of line integrals as its last axis, as .npy")
    return lines


def _write_for_astra(output: Path, fan: FanBeamGeometry) -> None:
    """Write a row per view, in the form of ASTRA's `fanflat_vec`."""
    header = f"astra fanflat_vec, mm: srcX srcY dX dY uX uY; {fan.scanner.num_detector_pixels} cells"
    np.savetxt(output, fan.astra_vectors(), fmt="%.12g", header=header)


def _json(output: Path, arguments: dict[str, Any]) -> None:
    output.write_text(json.dumps(arguments, indent=1) + "\n", encoding="utf-8")


def _write_for_rtk(output: Path, fan: FanBeamGeometry) -> None:
    scanner = fan.scanner
    pitch, origin = scanner.detector_pitch_mm, float(cell_centres_mm(scanner)[0])
    remark = f"projections: {scanner.num_detector_pixels} cells, spacing {pitch!r} mm, origin {origin!r} mm"
    output.write_text(rtk_xml(rtk_arguments(fan), remark), encoding="utf-8")


_WRITERS: Mapping[ExportTarget, Callable[[Path, FanBeamGeometry], None]] = MappingProxyType(
    {
        ExportTarget.VECTORS: lambda output, fan: _json(output, vectors_of(fan)),
        ExportTarget.ASTRA: _write_for_astra,
        ExportTarget.ODL: lambda output, fan: _json(output, odl_arguments(fan)),
        ExportTarget.CIL: lambda output, fan: _json(output, cil_arguments(fan)),
        ExportTarget.RTK: _write_for_rtk,
    }
)


HEAD = '<?xml version="1.0"?>\n<!DOCTYPE RTKGEOMETRY>\n<RTKThreeDCircularGeometry version="3">\n'


def rtk_xml(arguments: dict[str, Any], remark: str) -> str:
    """Write the text of the file; RTK recomputes the matrices, and refuses a file in which they disagree.

    The remark is at the top: the geometry does not hold the projections' spacing and origin.
    """
    *lengths, (_, angles), (_, matrices) = arguments.items()
    parts = [f"  <!-- {remark} -->", *(f"  <{name}>{value!r}</{name}>" for name, value in lengths)]
    for angle, matrix in zip(angles.tolist(), matrices.tolist(), strict=True):
        rows = "\n".join(" ".join(map(repr, row)) for row in matrix)
        parts += ["  <Projection>", f"    <GantryAngle>{angle!r}</GantryAngle>", f"    <Matrix>\n{rows}\n</Matrix>"]
        parts.append("  </Projection>")
    return HEAD + "\n".join([*parts, "</RTKThreeDCircularGeometry>", ""])
