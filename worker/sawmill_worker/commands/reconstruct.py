"""`sawmill reconstruct`: volume from a scan's file and a geometry."""
# ruff: noqa: PLC0415 - drawing is imported only if a picture is requested

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

from sawmill_calibration.failures import refused
from sawmill_calibration.reconstruction.reconstruct import ReconstructionInput, run_reconstruction
from sawmill_calibration.scans.scan_rows import ScanRows, open_rows
from sawmill_calibration.scans.scan_source import ScanSource
from sawmill_contracts.reconstructions import ReconstructionOptions, ReconstructionResult
from sawmill_formats.errors import NotStored
from sawmill_vocabulary import Handedness, ProgressCallback, Rotation, Theta
from sawmill_vocabulary.scattered_radiation import NOTHING_FOUND, BeamCorrection
from sawmill_worker.commands.calibrated_scan import open_with_calibration
from sawmill_worker.commands.geometry_options import CalibrationSource, ThetaSource
from sawmill_worker.commands.options import Pictures

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
    """Read, reconstruct each row into the volume, and draw the requested pictures."""
    with _open(scan, geometry, output, on_progress) as (used, reconstruction_input):
        result = run_reconstruction(reconstruction_input, options, output, used.on_progress)
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
    from sawmill_formats.output.volume_reader import volume_slice
    from sawmill_worker.pictures.images import image_png

    middle = volume_slice(volume, result.shape, result.shape[0] // 2)
    title = f"{name}, {middle.label}"
    return image_png(middle.data, pixel_mm=middle.pixel_mm, unit=middle.unit, window=result.value_range, title=title)


def _mosaic(volume: Path, result: ReconstructionResult, name: str) -> bytes:
    from sawmill_formats.output.volume_reader import volume_slices
    from sawmill_worker.pictures.log_pictures import mosaic_png, spread

    slices = volume_slices(volume, result.shape, spread(MOSAIC_SLICES, result.shape[0]))
    tiles = ((image.data, image.label) for image in slices)
    return mosaic_png(tiles, pixel_mm=result.pixel_mm, unit=result.unit, window=result.value_range, title=name)


def _side(volume: Path, result: ReconstructionResult, name: str) -> bytes:
    from sawmill_formats.output.volume_reader import side_view
    from sawmill_worker.pictures.log_pictures import side_view_png

    view = side_view(volume, result.shape, "x")
    return side_view_png(
        view.data, across_mm=view.across_mm, across=view.across, along_mm=view.along_mm, unit=view.unit, title=name
    )


def _curve(volume: Path, _: ReconstructionResult, __: str) -> bytes:
    from sawmill_formats.output.volume_reader import alpha_curve
    from sawmill_worker.pictures.alpha_curve import alpha_curve_png

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
    with open_with_calibration(scan, geometry, on_progress=on_progress, beside=output) as (calibration, used):
        like = replace(used, scanner=replace(used.scanner, detector_modules=calibration.scanner.detector_modules))
        yield used, _input(like, calibration.theta, calibration.rotation, calibration.handedness, calibration.beam)


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
