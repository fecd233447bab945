import xml.etree.ElementTree as ET

import numpy as np
import pytest

from sawmill_worker.commands.export import rtk_xml

SID, SDD, SOURCE, PROJECTION = 900.0, 1600.0, 75.0, 150.0
GANTRY_DEG = np.array([12.5, 181.0, 359.0])


def matrix(gantry_deg: float) -> np.ndarray:
    """A point (x, y, z) to the detector, after RTK's documentation of its geometry."""
    c, s = np.cos(np.deg2rad(gantry_deg)), np.sin(np.deg2rad(gantry_deg))
    shift = np.array([[1, 0, SOURCE - PROJECTION], [0, 1, 0], [0, 0, 1]])
    magnify = np.array([[-SDD, 0, 0, 0], [0, -SDD, 0, 0], [0, 0, 1, -SID]])
    turn = np.array([[c, 0, -s, -SOURCE], [0, 1, 0, 0], [s, 0, c, 0], [0, 0, 0, 1]])
    return shift @ magnify @ turn


NAMED = {
    "SourceToIsocenterDistance": SID,
    "SourceToDetectorDistance": SDD,
    "SourceOffsetX": SOURCE,
    "ProjectionOffsetX": PROJECTION,
}


@pytest.fixture
def text():
    matrices = np.stack([matrix(angle) for angle in GANTRY_DEG])
    return rtk_xml({**NAMED, "GantryAngle": GANTRY_DEG, "Matrix": matrices}, "three views")


def test_the_file_holds_every_number_to_the_last_digit(text):
    assert text.startswith('<?xml version="1.0"?>\n<!DOCTYPE RTKGEOMETRY>\n')
    root = ET.fromstring(text)  # noqa: S314 - our own text
    assert (root.tag, root.get("version")) == ("RTKThreeDCircularGeometry", "3")
    assert {name: float(root.findtext(name)) for name in NAMED} == NAMED
    views = root.findall("Projection")
    assert [float(view.findtext("GantryAngle")) for view in views] == GANTRY_DEG.tolist()
    for view, angle in zip(views, GANTRY_DEG, strict=True):
        assert np.array_equal(np.array(view.findtext("Matrix").split(), float).reshape(3, 4), matrix(angle))
