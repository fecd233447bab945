"""RTK's geometry file, version 3, which `rtk.read_geometry` reads."""

from xml.etree import ElementTree as ET

import numpy as np
from numpy.typing import NDArray

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
