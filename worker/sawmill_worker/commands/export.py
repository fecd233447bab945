"""`sawmill export`: a calibrated geometry for another toolkit, such as RTK's geometry file, version 3."""

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from types import MappingProxyType
from xml.etree import ElementTree as ET

import numpy as np
from numpy.typing import NDArray

from sawmill_calibration.result_file import read_calibration
from sawmill_calibration.view_vectors import write_views
from sawmill_formats.input.angles import AnglesGiven
from sawmill_tomography.geometry.export import cil_arguments, odl_arguments, rtk_geometry
from sawmill_tomography.geometry.geometry import FanBeamGeometry, cell_centres_mm
from sawmill_worker.commands.options import ExportTarget


def export_geometry(target: ExportTarget, calibration: Path, output: Path, angles: AnglesGiven, views: int) -> None:
    """Write a calibration's geometry at the given views for a toolkit, or as vectors, which `--geometry` reads."""
    result = read_calibration(calibration)
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
        ExportTarget.VECTORS: write_views,
        ExportTarget.ASTRA: _write_for_astra,
        ExportTarget.ODL: _write_for_odl,
        ExportTarget.CIL: _write_for_cil,
        ExportTarget.RTK: _write_for_rtk,
    }
)


HEAD = '<?xml version="1.0"?>\n<!DOCTYPE RTKGEOMETRY>\n'


def rtk_xml(
    *,
    source_to_isocenter_mm: float,
    source_to_detector_mm: float,
    source_offset_x_mm: float,
    projection_offset_x_mm: float,
    gantry_angles_deg: NDArray[np.float64],
    matrices: NDArray[np.float64],
    remark: str,
) -> str:
    """Write the text of the file.

    Parameters
    ----------
    gantry_angles_deg : (views,) float
    matrices : (views, 3, 4) float
        Matrices, which RTK recomputes from the parameters; it refuses a file in which the two disagree.
    remark : str
        Comment at the top: the geometry does not hold the projections' spacing and origin.
    """
    root = ET.Element("RTKThreeDCircularGeometry", version="3")
    root.append(ET.Comment(f" {remark} "))
    for name, value in (
        ("SourceToIsocenterDistance", source_to_isocenter_mm),
        ("SourceToDetectorDistance", source_to_detector_mm),
        ("SourceOffsetX", source_offset_x_mm),
        ("ProjectionOffsetX", projection_offset_x_mm),
    ):
        ET.SubElement(root, name).text = repr(value)
    for angle, matrix in zip(gantry_angles_deg.tolist(), matrices, strict=True):
        projection = ET.SubElement(root, "Projection")
        ET.SubElement(projection, "GantryAngle").text = repr(angle)
        rows = "\n".join(" ".join(repr(value) for value in row) for row in matrix.tolist())
        ET.SubElement(projection, "Matrix").text = f"\n{rows}\n"
    ET.indent(root)
    return f"{HEAD}{ET.tostring(root, encoding='unicode')}\n"
