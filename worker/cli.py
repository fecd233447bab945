"""The commands that need no server: calibrate, reconstruct, simulate, export, worker (DESIGN section 8)."""

import json
import math
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from enum import StrEnum
from pathlib import Path
from typing import Annotated
from uuid import uuid4

import numpy as np
import typer
from pydantic import TypeAdapter, ValidationError
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.table import Table

from worker import scan_input
from worker.contracts import jobs
from worker.contracts.base import DataKind, Handedness, Rotation, Rows
from worker.contracts.calibrations import (
    CalibrationFile,
    CalibrationMethod,
    CalibrationOptions,
    CalibrationResult,
    PaperOptions,
)
from worker.contracts.geometry import Theta
from worker.contracts.phantoms import PhantomDrawing
from worker.contracts.reconstructions import FilterName, ReconstructionOptions
from worker.execution.poller import main as run_embedded_worker
from worker.formats.angles import parse_angles
from worker.formats.picture import read_picture
from worker.formats.scan_file import write_raw_scan, write_scan
from worker.pictures.images import image_png
from worker.tasks.calibrating import CalibrationInput, run_calibration, write_report_png
from worker.tasks.conversion import from_phantom, to_phantom, to_scanner, to_theta
from worker.tasks.failures import JobFailure, input_errors_translated, refused
from worker.tasks.reconstructing import ReconstructionInput, Report, run_reconstruction
from worker.tasks.report_table import report_table
from worker.tasks.writing_volumes import write_volume
from worker.tomography import geometry
from worker.tomography.built_in import BUILT_IN
from worker.tomography.geometry import FanBeamGeometry
from worker.tomography.log_model import SAPWOOD_PER_MM, LogModel
from worker.tomography.phantom import Phantom
from worker.tomography.simulate import simulate_sinogram, simulate_stack
from worker.tomography.tracing import trace

app = typer.Typer(no_args_is_help=True, add_completion=False, pretty_exceptions_show_locals=False)
errors = Console(stderr=True)

JsonFlag = Annotated[bool, typer.Option("--json", help="Print one JSON object on standard output and nothing else.")]
PhantomText = Annotated[
    str,
    typer.Option("--phantom", metavar="NAME|FILE", help=f"{', '.join(BUILT_IN)}, a drawing FILE.json, or a FILE.png."),
]
PhantomWidth = Annotated[float | None, typer.Option(min=0.0, help="Width of a phantom's PNG, the whole picture.")]
ThetaText = Annotated[
    str | None, typer.Option("--theta", metavar="a,r,h,h,t", help="alpha0 (rad), r_D, h_S, h_D (mm), alpha_D.")
]


@contextmanager
def answering(*, as_json: bool) -> Iterator[None]:
    """Turn a refusal into one sentence (or one JSON object) and exit code 1."""
    try:
        with input_errors_translated():
            yield
    except JobFailure as failure:
        if as_json:
            _print_json(
                {
                    "state": "failed",
                    "failure": {"kind": failure.kind.value, "code": failure.code, "detail": failure.detail},
                }
            )
        errors.print(f"[bold red]{failure.code}[/]: {failure.detail}", highlight=False)
        raise typer.Exit(1) from failure
    except OSError as error:
        if as_json:
            _print_json(
                {"state": "failed", "failure": {"kind": "passing", "code": "file-system", "detail": str(error)}}
            )
        errors.print(f"[bold red]file-system[/]: {error}", highlight=False)
        raise typer.Exit(1) from error


@contextmanager
def showing_progress(what: str) -> Iterator[Report]:
    """A progress bar on standard error, where a person looks at it."""
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.percentage:3.0f} %"),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=errors, transient=True, disable=not errors.is_terminal) as bar:
        task = bar.add_task(what, total=1.0)

        def report(progress: jobs.Progress) -> None:
            best = "" if progress.best_value is None else f", best {progress.best_value:.5g}"
            generation = "" if progress.generation is None else f" generation {progress.generation}{best}"
            bar.update(task, completed=progress.fraction, description=f"{what}: {progress.stage}{generation}")

        yield report


def _print_json(document: object) -> None:
    sys.stdout.write(json.dumps(document, allow_nan=False) + "\n")


def parse_theta(text: str) -> Theta:
    """Theta from five numbers separated by commas; anything else is wrong use."""
    try:
        values = [float(part) for part in text.split(",")]
        return Theta(**dict(zip(Theta.model_fields, values, strict=True)))
    except ValueError as error:
        raise typer.BadParameter(f"--theta needs five numbers a,r,h,h,t, not {text!r}") from error


def parse_rows_flag(rows: str | None) -> Rows | None:
    """A:B, checked; anything else is wrong use."""
    if rows is None:
        return None
    try:
        return TypeAdapter(Rows).validate_python(rows)
    except ValidationError as error:
        raise typer.BadParameter(f"--rows must be A:B with 0 <= A < B, as in 0:16, not {rows!r}") from error


def find_phantom(text: str, width_mm: float | None) -> PhantomDrawing:
    """A built-in phantom by name, a drawing from FILE.json, or a FILE.png of known width."""
    if text in BUILT_IN:
        return from_phantom(BUILT_IN[text])
    path = Path(text)
    if not path.is_file():
        raise typer.BadParameter(f"--phantom must be {', '.join(BUILT_IN)} or an existing file, not {text!r}")
    if path.suffix.lower() == ".json":
        try:
            return PhantomDrawing.model_validate_json(path.read_bytes())
        except ValidationError as error:
            first = error.errors()[0]
            where = ".".join(str(part) for part in first["loc"])
            raise refused("phantom", f"{path.name} is not a phantom's drawing: {where}: {first['msg']}") from error
    if width_mm is None:
        raise typer.BadParameter("a phantom's picture needs its width: give --phantom-width-mm")
    return from_phantom(trace(read_picture(path), width_mm, name=path.stem))


@app.command()
def calibrate(
    scan: scan_input.ScanFile,
    data: scan_input.Data,
    source_to_cor_mm: scan_input.SourceToCor,
    phantom: PhantomText,
    dataset: scan_input.Dataset = None,
    angles_deg: scan_input.AnglesDeg = None,
    angles_file: scan_input.AnglesFile = None,
    views: scan_input.Views = None,
    rows: scan_input.RowsText = None,
    detector_pitch_mm: scan_input.DetectorPitch = None,
    row_pitch_mm: scan_input.RowPitch = None,
    phantom_width_mm: PhantomWidth = None,
    handedness: Annotated[
        Handedness | None, typer.Option(help="From which end the phantom was seen; both are tried.")
    ] = None,
    rotation: Annotated[Rotation | None, typer.Option(help="Which way the angles count; both are tried.")] = None,
    method: Annotated[
        CalibrationMethod, typer.Option(help="The product's own, or the published search.")
    ] = CalibrationMethod.DEFAULT,
    seed: Annotated[int, typer.Option(min=0, max=2**32 - 1, help="Of the search.")] = 7,
    rays_per_cell: Annotated[
        int | None, typer.Option(min=1, max=64, help="Rays a cell in the model; the whole cell by default.")
    ] = None,
    paper_objective: Annotated[str, typer.Option(help="image or projection.")] = "image",
    paper_weighting: Annotated[str, typer.Option(help="none or exact.")] = "none",
    paper_correlation: Annotated[str, typer.Option(help="unnormalised or normalised.")] = "unnormalised",
    paper_stop: Annotated[str, typer.Option(help="published or tight.")] = "published",
    report: Annotated[Path | None, typer.Option(metavar="OUT.png", help="Write a report picture.")] = None,
    as_json: JsonFlag = False,  # noqa: FBT002 - a flag
) -> None:
    """Find the geometry from a scan of a phantom."""
    angles = scan_input.given_angles(angles_deg, angles_file)
    chosen_rows = parse_rows_flag(rows)
    try:
        paper = PaperOptions.model_validate(
            {
                "objective": paper_objective,
                "weighting": paper_weighting,
                "correlation": paper_correlation,
                "stop": paper_stop,
            }
        )
    except ValidationError as error:
        first = error.errors()[0]
        raise typer.BadParameter(f"--paper-{first['loc'][0]}: {first['msg']}") from error
    with answering(as_json=as_json):
        drawing = find_phantom(phantom, phantom_width_mm)
        used = scan_input.load(
            scan,
            data=data,
            dataset=dataset,
            angles=angles,
            views=views,
            rows=chosen_rows,
            source_to_cor_mm=source_to_cor_mm,
            detector_pitch_mm=detector_pitch_mm,
            row_pitch_mm=row_pitch_mm,
        )
        given = CalibrationInput(
            sinogram=used.stack.mean(axis=1, dtype=np.float64),
            angles_rad=used.angles_rad,
            rows=used.rows,
            scanner=used.scanner,
            bounds=None,
            drawing=drawing,
            input_sha256=used.sha256,
        )
        options = CalibrationOptions(
            rows=chosen_rows,
            views=views,
            handedness=handedness,
            rotation=rotation,
            method=method,
            seed=seed,
            rays_per_cell=rays_per_cell,
            paper=paper,
        )
        with showing_progress("calibrate") as progress:
            calibration, result = run_calibration(given, options, progress)
        if report is not None:
            write_report_png(report, calibration, result, given)
    if as_json:
        _print_json(CalibrationFile(id=str(uuid4()), **dict(result)).model_dump(mode="json"))
    else:
        _print_calibration(result)


def _print_calibration(result: CalibrationResult) -> None:
    colour = {"pass": "green", "watch": "yellow", "fail": "red"}[result.verdict]
    table = Table(title=f"Calibration with {result.phantom}: [bold {colour}]{result.verdict}[/]", show_header=False)
    for label, value in report_table(result):
        table.add_row(label, value)
    Console().print(table)
    for reason in result.reasons:
        Console().print(f"- {reason}", highlight=False)


@app.command()
def reconstruct(
    scan: scan_input.ScanFile,
    data: scan_input.Data,
    output: Annotated[Path, typer.Option("--output", "-o", metavar="OUT.h5", help="The volume.")],
    source_to_cor_mm: Annotated[float | None, typer.Option(min=0.0, help="r_S; a calibration carries it.")] = None,
    dataset: scan_input.Dataset = None,
    angles_deg: scan_input.AnglesDeg = None,
    angles_file: scan_input.AnglesFile = None,
    views: scan_input.Views = None,
    rows: scan_input.RowsText = None,
    detector_pitch_mm: scan_input.DetectorPitch = None,
    row_pitch_mm: scan_input.RowPitch = None,
    theta: ThetaText = None,
    rotation: Annotated[Rotation | None, typer.Option(help="With --theta: which way the angles count.")] = None,
    calibration: Annotated[
        Path | None,
        typer.Option(metavar="RESULT.json", exists=True, dir_okay=False, help="What calibrate --json printed."),
    ] = None,
    method: Annotated[str, typer.Option(help="fbp.")] = "fbp",
    filter_name: Annotated[FilterName, typer.Option("--filter", help="Window on the ramp.")] = FilterName.HANN,
    frequency_scaling: Annotated[float, typer.Option(help="Cut-off as a fraction of the Nyquist frequency.")] = 1.0,
    weighting: Annotated[str, typer.Option(help="exact, or none as the published pipeline.")] = "exact",
    size: Annotated[int, typer.Option(min=16, max=4096, help="Pixels along each side.")] = 256,
    field_mm: Annotated[float, typer.Option(min=0.001, help="Side of the square field.")] = 400.0,
    png: Annotated[Path | None, typer.Option(metavar="OUT.png", help="Write a picture of the middle slice.")] = None,
    as_json: JsonFlag = False,  # noqa: FBT002 - a flag
) -> None:
    """Reconstruct each row of a scan."""
    if (theta is None) == (calibration is None):
        raise typer.BadParameter("give the geometry as --theta or as --calibration, one of them")
    if calibration is not None and rotation is not None:
        raise typer.BadParameter("--rotation comes with --theta; a calibration carries its own")
    angles = scan_input.given_angles(angles_deg, angles_file)
    chosen_rows = parse_rows_flag(rows)
    try:
        options = ReconstructionOptions.model_validate(
            {
                "rows": chosen_rows,
                "views": views,
                "method": method,
                "filter": filter_name,
                "frequency_scaling": frequency_scaling,
                "weighting": weighting,
                "size": size,
                "field_mm": field_mm,
            }
        )
    except ValidationError as error:
        first = error.errors()[0]
        raise typer.BadParameter(f"--{str(first['loc'][0]).replace('_', '-')}: {first['msg']}") from error
    with answering(as_json=as_json):
        known = None if calibration is None else _read_calibration(calibration)
        r_s = _source_to_cor(source_to_cor_mm, known)
        used = scan_input.load(
            scan,
            data=data,
            dataset=dataset,
            angles=angles,
            views=views,
            rows=chosen_rows,
            source_to_cor_mm=r_s,
            detector_pitch_mm=detector_pitch_mm if known is None else known.scanner.detector_pitch_mm,
            row_pitch_mm=row_pitch_mm,
        )
        if known is not None:
            _check_same_scanner(known, used, detector_pitch_mm)
        given = ReconstructionInput(
            line_integrals=used.stack,
            angles_rad=used.angles_rad,
            rows=used.rows,
            scanner=used.scanner,
            theta=known.theta if known is not None else parse_theta(theta or ""),
            rotation=known.rotation if known is not None else rotation or Rotation.AS_GIVEN,
            handedness=known.handedness if known is not None else Handedness.AS_DRAWN,
            input_sha256=used.sha256,
        )
        with showing_progress("reconstruct") as progress:
            volume, result = run_reconstruction(given, options, progress)
        write_volume(output, volume, result, options, used.scanner)
        if png is not None:
            middle = volume[len(volume) // 2]
            png.write_bytes(
                image_png(
                    middle, pixel_mm=result.pixel_mm, unit=result.unit, title=f"{scan.name}, slice {len(volume) // 2}"
                )
            )
    if as_json:
        _print_json(result.model_dump(mode="json"))
    else:
        slices, width, _ = result.shape
        errors.print(
            f"{slices} slice(s) of {width} x {width} pixels in {result.time_s:.2f} s: {output}", highlight=False
        )


def _read_calibration(path: Path) -> CalibrationResult:
    try:
        return CalibrationFile.read(path.read_text())
    except ValueError as error:  # JSON, text encoding and pydantic errors alike
        reason = str(error).splitlines()[0]
        raise refused("calibration", f"{path.name} is not what calibrate --json prints: {reason}") from error


def _source_to_cor(flag: float | None, known: CalibrationResult | None) -> float:
    if known is None:
        if flag is None:
            raise typer.BadParameter("--theta needs --source-to-cor-mm")
        return flag
    r_s = known.scanner.source_to_cor_mm
    if flag is not None and not math.isclose(flag, r_s, rel_tol=1e-6):
        raise refused(
            "contradiction", f"the calibration says source_to_cor_mm {r_s:.9g} and {flag:.9g} was given; correct one"
        )
    return r_s


def _check_same_scanner(known: CalibrationResult, used: scan_input.ScanInput, pitch_flag: float | None) -> None:
    if known.scanner.num_detector_pixels != used.scanner.num_detector_pixels:
        raise refused(
            "contradiction",
            f"the calibration is of a detector of {known.scanner.num_detector_pixels} cells and the scan has "
            f"{used.scanner.num_detector_pixels}: use the calibration of the same scanner",
        )
    pitch = known.scanner.detector_pitch_mm
    if pitch_flag is not None and not math.isclose(pitch_flag, pitch, rel_tol=1e-6):
        raise refused(
            "contradiction",
            f"the calibration says detector_pitch_mm {pitch:.9g} and {pitch_flag:.9g} was given; correct one",
        )


class Body(StrEnum):
    """What can be simulated beside a phantom."""

    LOG = "log"
    LOG_WITH_PHANTOM = "log-with-phantom"


@app.command()
def simulate(
    body: Annotated[
        str,
        typer.Argument(
            metavar="BODY",
            help="A phantom (name or FILE.json), log, or log-with-phantom, whose first rows show a phantom.",
        ),
    ],
    theta: Annotated[
        str, typer.Option("--theta", metavar="a,r,h,h,t", help="alpha0 (rad), r_D, h_S, h_D (mm), alpha_D.")
    ],
    output: Annotated[Path, typer.Option("--output", "-o", metavar="OUT.h5", help="The scan, HDF5 in NXtomo layout.")],
    data: scan_input.Data = DataKind.COUNTS,
    source_to_cor_mm: scan_input.SourceToCor = 859.46,
    detector_pitch_mm: Annotated[float, typer.Option(min=0.0)] = 1.502864583,
    detector_pixels: Annotated[int, typer.Option(min=8)] = 768,
    row_pitch_mm: Annotated[float, typer.Option(min=0.0)] = 2.0,
    angles_deg: Annotated[
        str | None, typer.Option(metavar="START:STEP", help="A full turn from half a step by default.")
    ] = None,
    views: Annotated[int, typer.Option(min=3)] = 360,
    rows: Annotated[int, typer.Option(min=1, help="Rows of the stack.")] = 1,
    phantom: Annotated[str, typer.Option(help="Of log-with-phantom.")] = "l-shape",
    phantom_rows: Annotated[int, typer.Option(min=1, help="Rows of log-with-phantom that show the phantom.")] = 4,
    position_mm: Annotated[str, typer.Option(metavar="X,Y", help="Where the phantom stands.")] = "0,0",
    handedness: Annotated[Handedness, typer.Option(help="From which end it is seen.")] = Handedness.AS_DRAWN,
    rotation: Annotated[Rotation, typer.Option(help="Which way the angles count.")] = Rotation.AS_GIVEN,
    noise: Annotated[
        float, typer.Option(min=0.0, help="Of line integrals: standard deviation against their RMS.")
    ] = 0.0,
    background: Annotated[float, typer.Option(help="Of line integrals: added everywhere.")] = 0.0,
    photons: Annotated[float, typer.Option(min=1.0, help="Of counts: in air, a cell and view.")] = 30_000.0,
    seed: Annotated[int, typer.Option(min=0)] = 1,
) -> None:
    """Simulate a scan of a phantom or a synthetic log, analytically, seeded."""
    scanner = geometry.Scanner(source_to_cor_mm, detector_pixels, detector_pitch_mm)
    with answering(as_json=False):
        given = parse_angles(angles_deg or f"{180.0 / views}:{360.0 / views}")
        angles = np.deg2rad(given.expand(views))
        fan = FanBeamGeometry(scanner, to_theta(parse_theta(theta)), geometry.Rotation(rotation).apply(angles))
        attenuating = data is DataKind.COUNTS or body in set(Body)
        slices = _slices(
            body,
            rows=rows,
            phantom=phantom,
            phantom_rows=phantom_rows,
            seed=seed,
            attenuating=attenuating,
            handedness=handedness,
            position=position_mm,
            row_pitch_mm=row_pitch_mm,
        )
        if data is DataKind.COUNTS:
            stack = simulate_stack(slices, fan, photons=photons, seed=seed)
            write_raw_scan(
                output,
                counts=stack.counts,
                flats=stack.flats,
                darks=stack.darks,
                angles_rad=angles,
                detector_pitch_mm=detector_pitch_mm,
                row_pitch_mm=row_pitch_mm,
            )
        else:
            layers = [
                simulate_sinogram(piece, fan, noise=noise, background=background, seed=seed + row)
                for row, piece in enumerate(slices)
            ]
            write_scan(
                output,
                line_integrals=np.stack(layers, axis=1).astype(np.float32),
                angles_rad=angles,
                detector_pitch_mm=detector_pitch_mm,
                row_pitch_mm=row_pitch_mm,
                air_level=None,
                provenance={"simulated": body, "seed": str(seed), "theta": theta},
            )
    errors.print(f"{views} views, {len(slices)} row(s), {detector_pixels} cells: {output}", highlight=False)


def _slices(
    body: str,
    *,
    rows: int,
    phantom: str,
    phantom_rows: int,
    seed: int,
    attenuating: bool,
    handedness: Handedness,
    position: str,
    row_pitch_mm: float,
) -> list[Phantom]:
    """One cross-section a row; a phantom's wood attenuates like sapwood where counts are simulated."""

    def placed(text: str) -> Phantom:
        drawn = to_phantom(find_phantom(text, None))
        seen = drawn if handedness is Handedness.AS_DRAWN else drawn.mirrored()
        x, y = _position(position)
        moved = seen.moved(x, y)
        return moved.of_density(SAPWOOD_PER_MM) if attenuating else moved

    if body not in set(Body):
        return [placed(body)] * rows
    log = LogModel.random(seed, length_mm=max(400.0, rows * row_pitch_mm))
    heights = [20.0 + row * row_pitch_mm for row in range(rows)]
    slices = [log.slice_at(height) for height in heights]
    if body == Body.LOG_WITH_PHANTOM:
        if phantom_rows >= rows:
            raise typer.BadParameter(f"--phantom-rows {phantom_rows} leaves no row for the log: give more --rows")
        slices[:phantom_rows] = [placed(phantom)] * phantom_rows
    return slices


def _position(text: str) -> tuple[float, float]:
    try:
        x, y = (float(part) for part in text.split(","))
    except ValueError as error:
        raise typer.BadParameter(f"--position-mm needs X,Y, not {text!r}") from error
    return x, y


class ExportTarget(StrEnum):
    """Toolkits that a geometry can be written for."""

    ASTRA = "astra"


@app.command()
def export(
    calibration: Annotated[Path, typer.Option(metavar="RESULT.json", exists=True, dir_okay=False)],
    to: Annotated[ExportTarget, typer.Option(help="astra: rows srcX srcY dX dY uX uY of fanflat_vec, mm.")],
    output: Annotated[Path, typer.Option("--output", "-o", metavar="OUT.txt")],
    views: Annotated[int, typer.Option(min=1, help="Number of views.")],
    angles_deg: scan_input.AnglesDeg = None,
    angles_file: scan_input.AnglesFile = None,
) -> None:
    """Write a calibrated geometry for another toolkit."""
    given = scan_input.given_angles(angles_deg, angles_file)
    if given is None:
        raise typer.BadParameter("the views' angles are missing: give --angles-deg START:STEP or --angles-file")
    with answering(as_json=False):
        known = _read_calibration(calibration)
        angles = geometry.Rotation(known.rotation).apply(np.deg2rad(given.expand(views)))
        fan = FanBeamGeometry(to_scanner(known.scanner), to_theta(known.theta), angles)
        header = f"{to.value} fanflat_vec, mm: srcX srcY dX dY uX uY; {known.scanner.num_detector_pixels} cells"
        np.savetxt(output, fan.astra_vectors(), fmt="%.12g", header=header)
    errors.print(f"{views} views: {output}", highlight=False)


@app.command()
def worker(
    data: Annotated[
        Path | None, typer.Option("--data", help="Data folder; SAWMILL_DATA_FOLDER or the default otherwise.")
    ] = None,
) -> None:
    """Run one embedded worker beside a service that uses the same data folder."""
    if data is not None:
        os.environ["SAWMILL_DATA_FOLDER"] = str(data)
    run_embedded_worker([])
