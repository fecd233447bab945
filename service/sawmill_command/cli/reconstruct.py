"""`sawmill reconstruct` and `sawmill image-quality`: flags and output."""
# ruff: noqa: PLC0415, FBT002 - imports inside the command: its help needs none; flags are booleans with a default

from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import typer
from typer.models import OptionInfo

from sawmill_contracts.reconstructions import ReconstructionOptions
from sawmill_platform.attempts.importing import importing
from sawmill_vocabulary import ReconstructionMethod, Theta
from sawmill_worker.commands import geometry_options
from sawmill_worker.commands import options as shared
from sawmill_worker.commands.from_contract import Flags, from_contracts
from sawmill_worker.commands.terminal import answering, print_json, say, showing_progress

app = typer.Typer()


def _picture(description: str) -> OptionInfo:
    """Create the flag of a picture to write."""
    flag: OptionInfo = typer.Option(metavar="OUT.png", dir_okay=False, callback=shared.writable, help=description)
    return flag


def _one_number(text: str) -> float:
    """Parse a number, or refuse the text (a Typer parser)."""
    try:
        number = float(text)
    except ValueError as error:
        raise typer.BadParameter(
            f"{text!r} is not one number: pixels are square, and one number says both sides."
        ) from error
    return int(number) if number.is_integer() else number


def _coordinates_of(text: str) -> tuple[float, float]:
    """Parse X and Y from X,Y (a Typer parser)."""
    position = geometry_options.position_of(text)
    return position.x, position.y


OF_FIELD: Mapping[str, Mapping[str, Any]] = {
    "rows": {"metavar": "A:B[:STEP]"},
    "size": {"parser": _one_number, "metavar": "INTEGER"},
    "field_mm": {"parser": _one_number, "metavar": "FLOAT"},
    "field_centre_mm": {"parser": _coordinates_of, "metavar": "X,Y", "default": "0,0"},
}


@app.command(cls=geometry_options.WithGeometry)
@from_contracts
def reconstruct(
    scan: shared.ScanFile,
    reading: shared.ScanFlags,
    output: shared.Result,
    options: Annotated[ReconstructionOptions, Flags(**OF_FIELD)],
    theta: Annotated[Theta | None, geometry_options.ThetaFlag] = None,
    source_to_cor_mm: geometry_options.SourceToCorOfTheta = None,
    rotation: geometry_options.RotationOfTheta = None,
    calibration: Annotated[Path | None, geometry_options.CalibrationFlag] = None,
    geometry: Annotated[Path | None, geometry_options.GeometryFlag] = None,
    png: Annotated[Path | None, _picture("Write a picture of the middle slice.")] = None,
    mosaic: Annotated[Path | None, _picture("Write a picture of slices along the log.")] = None,
    side: Annotated[Path | None, _picture("Write what is densest, from the side.")] = None,
    alpha_curve: Annotated[Path | None, _picture("Write how tikhonov's alpha was chosen.")] = None,
    as_json: shared.JsonFlag = False,
) -> None:
    """Reconstruct each row of a scan."""
    known_by = geometry_options.GeometryFlags(theta, rotation, calibration, source_to_cor_mm, geometry)
    if alpha_curve is not None and options.method is not ReconstructionMethod.TIKHONOV:
        raise typer.BadParameter("--alpha-curve is a picture of --method tikhonov.")
    source = shared.scan_source(scan, reading, views=options.views, rows=options.rows)
    with answering(as_json=as_json), showing_progress("reconstruct") as progress:
        with importing():
            from sawmill_calibration.reconstruction.reconstruct import run_reconstruction
            from sawmill_worker.commands.calibrated_scan import open_with_geometry
            from sawmill_worker.commands.report import draw_volume

        with open_with_geometry(source, known_by, on_progress=progress, beside=output) as (rows, known):
            result = run_reconstruction(rows, known, options, output, rows.on_progress)
        draw_volume(output, result, scan.name, middle=png, mosaic=mosaic, side=side, alpha_curve=alpha_curve)
    if as_json:
        print_json({"state": "succeeded", "output": str(output), **result.model_dump(mode="json")})
    slices, width, _ = result.shape
    say(f"{slices} slice(s) of {width} x {width} pixels in {result.time_s:.2f} s: {output}")
    if result.method is not None:
        from sawmill_worker.commands.tables import report_method

        report_method(result.method)


@app.command(cls=geometry_options.WithGeometry)
@from_contracts
def image_quality(
    scan: shared.ScanFile,
    reading: shared.ScanFlags,
    options: Annotated[ReconstructionOptions, Flags(method={"default": "fbp"}, **OF_FIELD)],
    theta: Annotated[Theta | None, geometry_options.ThetaFlag] = None,
    source_to_cor_mm: geometry_options.SourceToCorOfTheta = None,
    rotation: geometry_options.RotationOfTheta = None,
    calibration: Annotated[Path | None, geometry_options.CalibrationFlag] = None,
    geometry: Annotated[Path | None, geometry_options.GeometryFlag] = None,
    as_json: shared.JsonFlag = False,
) -> None:
    """Measure sharpness (MTF) and noise of images from a scan of a plain disc, which cannot calibrate."""
    known_by = geometry_options.GeometryFlags(theta, rotation, calibration, source_to_cor_mm, geometry)
    source = shared.scan_source(scan, reading, views=options.views, rows=options.rows)
    with answering(as_json=as_json), showing_progress("image quality") as progress:
        with importing():
            from sawmill_calibration.reconstruction.reconstruct import reconstruct_in_memory
            from sawmill_tomography.reconstruction.image_quality import image_quality as measured
            from sawmill_worker.commands.calibrated_scan import open_with_geometry
            from sawmill_worker.commands.tables import print_image_quality

        with open_with_geometry(source, known_by, on_progress=progress) as (rows, known):
            made = reconstruct_in_memory(rows, known, options, rows.on_progress)
        quality = measured(made.data, made.result.pixel_mm)
    if as_json:
        print_json({"state": "succeeded", **asdict(quality), "options": options.model_dump(mode="json")})
    else:
        print_image_quality(quality)
