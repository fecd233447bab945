"""Files of a simulation: the physical effects to simulate, and the simulated stack as a scanner would write it."""

from pathlib import Path

from sawmill_calibration.json_file import read_json
from sawmill_formats.output.scan_writer import write_raw_scan
from sawmill_tomography.geometry.geometry import FloatArray
from sawmill_tomography.projection.simulate import SimulatedStack
from sawmill_vocabulary.physics import Physics


def read_physics(path: Path) -> Physics:
    """Read physical effects from a JSON file; docs/do/simulate.md lists the fields.

    Raises
    ------
    JobFailure
        The file holds something else.
    """
    return read_json(path, Physics, code="physics", otherwise="no file of physics")


def write_simulated_scan(
    path: Path,
    stack: SimulatedStack,
    angles_rad: FloatArray,
    *,
    detector_pitch_mm: float,
    row_pitch_mm: float | None,
) -> None:
    """Write counts, flat and dark fields as an NXtomo file.

    Parameters
    ----------
    angles_rad : (views,)
        Angles as the scanner counts them.

    Raises
    ------
    OSError
        The file cannot be written.
    """
    write_raw_scan(
        path,
        counts=stack.counts,
        flats=stack.flats,
        darks=stack.darks,
        angles_rad=angles_rad,
        detector_pitch_mm=detector_pitch_mm,
        row_pitch_mm=row_pitch_mm,
    )
