"""`sawmill reconstruct`: a scan's file and a geometry to a volume."""

import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

from sawmill_worker.commands.geometry_options import CalibrationSource, ThetaSource
from sawmill_worker.commands.options import Pictures
from sawmill_worker.contracts.calibrations import CalibrationResult
from sawmill_worker.contracts.geometry import ScannerConstants
from sawmill_worker.contracts.reconstructions import ReconstructionOptions, ReconstructionResult
from sawmill_worker.files.errors import NotStored
from sawmill_worker.files.volume_reader import alpha_curve, side_view, volume_slice, volume_slices
from sawmill_worker.pictures.images import image_png
from sawmill_worker.pictures.log_pictures import mosaic_png, side_view_png, spread
from sawmill_worker.use_cases.failures import refused
from sawmill_worker.use_cases.reconstruct import ReconstructionInput, run_reconstruction
from sawmill_worker.use_cases.result_file import read_calibration
from sawmill_worker.use_cases.scan_rows import ScanRows, open_rows
from sawmill_worker.use_cases.scan_source import ScanSource
from sawmill_worker.vocabulary import Handedness, ProgressCallback, Rotation, Theta
from sawmill_worker.vocabulary.scattered_radiation import NOTHING_FOUND, BeamCorrection

MOSAIC_SLICES = 16


def reconstruct_scan(
    scan: ScanSource,
    geometry: ThetaSource | CalibrationSource,
    options: ReconstructionOptions,
    *,
    output: Path,
    pictures: Pictures,
    on_progress: ProgressCallback,
) -> ReconstructionResult:
    """Read, reconstruct each row into the volume, and draw the pictures that are asked for."""
    with _open(scan, geometry, output, on_progress) as (used, given):
        result = run_reconstruction(given, options, output, used.on_progress)
    drawings = (
        (pictures.middle, _middle),
        (pictures.mosaic, _mosaic),
        (pictures.side, _side),
        (pictures.alpha_curve, _curve),
    )
    for path, draw in drawings:
        if path is not None:
            path.write_bytes(draw(output, result, scan.path.name))
    return result


def _middle(volume: Path, result: ReconstructionResult, name: str) -> bytes:
    middle = volume_slice(volume, result.shape, result.shape[0] // 2)
    return image_png(middle.data, pixel_mm=middle.pixel_mm, unit=middle.unit, title=f"{name}, {middle.label}")


def _mosaic(volume: Path, result: ReconstructionResult, name: str) -> bytes:
    slices = volume_slices(volume, result.shape, spread(MOSAIC_SLICES, result.shape[0]))
    tiles = ((image.data, image.label) for image in slices)
    return mosaic_png(tiles, pixel_mm=result.pixel_mm, unit=result.unit, window=result.value_range, title=name)


def _side(volume: Path, result: ReconstructionResult, name: str) -> bytes:
    view = side_view(volume, result.shape, "x")
    return side_view_png(
        view.data, across_mm=view.across_mm, across=view.across, along_mm=view.along_mm, unit=view.unit, title=name
    )


def _curve(volume: Path, _: ReconstructionResult, __: str) -> bytes:
    from sawmill_worker.pictures.alpha_curve import alpha_curve_png  # noqa: PLC0415 - no other picture needs matplotlib

    try:
        columns = alpha_curve(volume)
    except NotStored as missing:
        raise refused(missing.code, f"the volume was written, but {missing}") from missing
    return alpha_curve_png(**columns)


@contextmanager
def _open(
    scan: ScanSource, geometry: ThetaSource | CalibrationSource, output: Path, on_progress: ProgressCallback
) -> Iterator[tuple[ScanRows, ReconstructionInput]]:
    if isinstance(geometry, ThetaSource):
        r_s = geometry.source_to_cor_mm
        with open_rows(scan, source_to_cor_mm=r_s, on_progress=on_progress, beside=output) as used:
            yield used, _input(used, geometry.theta, geometry.rotation, Handedness.AS_DRAWN, NOTHING_FOUND)
        return
    with open_with_calibration(scan, geometry, on_progress=on_progress, beside=output) as (known, used):
        yield used, _input(used, known.theta, known.rotation, known.handedness, known.beam)


@contextmanager
def open_with_calibration(
    scan: ScanSource, geometry: CalibrationSource, *, on_progress: ProgressCallback, beside: Path | None = None
) -> Iterator[tuple[CalibrationResult, ScanRows]]:
    """A calibration and a scan of the same scanner; what is given beside the calibration must agree with it."""
    known, scan = _calibrated(scan, geometry)
    r_s = known.scanner.source_to_cor_mm
    with open_rows(scan, source_to_cor_mm=r_s, on_progress=on_progress, beside=beside) as used:
        _check_same_detector(known, used.scanner)
        yield known, used


def _calibrated(scan: ScanSource, geometry: CalibrationSource) -> tuple[CalibrationResult, ScanSource]:
    """The calibration, and the scan with the detector pitch that the calibration carries."""
    known = read_calibration(geometry.path)
    r_s, pitch = known.scanner.source_to_cor_mm, known.scanner.detector_pitch_mm
    _check_agreement("source_to_cor_mm", r_s, geometry.source_to_cor_mm)
    _check_agreement("detector_pitch_mm", pitch, scan.options.detector_pitch_mm)
    return known, replace(scan, options=scan.options.model_copy(update={"detector_pitch_mm": pitch}))


def _input(
    used: ScanRows, theta: Theta, rotation: Rotation, handedness: Handedness, beam: BeamCorrection
) -> ReconstructionInput:
    return ReconstructionInput(
        read=used.read,
        angles_rad=used.angles_rad,
        rows=used.rows,
        scanner=used.scanner,
        theta=theta,
        rotation=rotation,
        handedness=handedness,
        input_sha256=used.sha256,
        counts=used.counts,
        preparation=used.remarks,
        row_step=used.row_step,
        beam=beam,
    )


def _check_agreement(name: str, carried: float, flag: float | None) -> None:
    if flag is not None and not math.isclose(flag, carried, rel_tol=1e-6):
        raise refused(
            "contradiction", f"the calibration carries {name} {carried:.9g} and {flag:.9g} was given; correct one"
        )


def _check_same_detector(known: CalibrationResult, scanner: ScannerConstants) -> None:
    calibrated, cells = known.scanner.num_detector_pixels, scanner.num_detector_pixels
    if calibrated != cells:
        raise refused(
            "contradiction",
            f"the calibration is of a detector of {calibrated} cells and the scan has {cells}: "
            "use the calibration of the same scanner",
        )
