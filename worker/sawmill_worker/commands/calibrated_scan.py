"""A scan and the geometry of a command line, for the commands that need both."""

import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np

from sawmill_calibration.failures import refused
from sawmill_calibration.known_geometry import GivenGeometry, check_same_scanner
from sawmill_calibration.result_file import read_calibration
from sawmill_calibration.scans.scan_rows import ScanRows, ScanSource, open_rows
from sawmill_calibration.view_vectors import AnyGeometry, ImportedGeometry, read_views
from sawmill_vocabulary import ProgressCallback, Rotation
from sawmill_worker.commands.geometry_options import GeometryFlags


@contextmanager
def open_with_geometry(
    scan: ScanSource, flags: GeometryFlags, *, on_progress: ProgressCallback, beside: Path | None = None
) -> Iterator[tuple[ScanRows, AnyGeometry]]:
    """Open a scan with a theta, with vectors, or with a calibration of the same scanner, whose constants must agree."""
    r_s, path = flags.source_to_cor_mm, flags.calibration
    calibration = None if path is None else read_calibration(path)
    if flags.vectors is not None:
        r_s = float(np.hypot(*read_views(flags.vectors).source_mm.T).mean())
    elif calibration is not None:
        r_s, pitch = calibration.scanner.source_to_cor_mm, calibration.scanner.detector_pitch_mm
        _check_agreement("source_to_cor_mm", r_s, flags.source_to_cor_mm)
        _check_agreement("detector_pitch_mm", pitch, scan.options.detector_pitch_mm)
        scan = replace(scan, options=scan.options.model_copy(update={"detector_pitch_mm": pitch}))
    assert r_s is not None  # noqa: S101 - checked by WithGeometry, as is a theta without the others
    with open_rows(scan, source_to_cor_mm=r_s, on_progress=on_progress, beside=beside) as used:
        if flags.vectors is not None:
            yield ImportedGeometry.of(read_views(flags.vectors, used.scanner.num_detector_pixels), used)
        elif flags.theta is not None:
            yield used, GivenGeometry(used.scanner, flags.theta, flags.rotation or Rotation.AS_GIVEN)
        elif calibration is not None:
            check_same_scanner(calibration.scanner, used.scanner)
            yield used, calibration


def _check_agreement(name: str, carried: float, flag: float | None) -> None:
    if flag is not None and not math.isclose(flag, carried, rel_tol=1e-6):
        raise refused(
            "contradiction", f"the calibration carries {name} {carried:.9g} and {flag:.9g} was given; correct one"
        )
