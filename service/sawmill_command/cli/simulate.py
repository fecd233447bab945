"""`sawmill simulate`: flags."""
# ruff: noqa: PLC0415 - imports inside the command: its help needs none

from pathlib import Path
from typing import Annotated, Any

import typer

from sawmill_contracts.geometry import ScannerConstants, SimulationOptions
from sawmill_vocabulary import DataKind, Handedness, Rotation, Theta
from sawmill_worker.commands import options as shared
from sawmill_worker.commands.from_contract import Flags, from_contracts, option
from sawmill_worker.commands.geometry_options import Position, ThetaFlag, position_of
from sawmill_worker.commands.options import (
    PhantomShape,
    PhantomText,
    PhantomWidth,
    body_names,
    body_or_phantom,
    check_width,
)
from sawmill_worker.commands.terminal import Command, OneOf, answering, say

app = typer.Typer()


class OfGeometry(Command):
    """A simulation turns the body before one pair, or passes it through several."""

    one_of = OneOf(("theta", "pairs"), "the geometry")


@app.command(cls=OfGeometry)
@from_contracts
def simulate(
    body: Annotated[
        str,
        typer.Argument(
            metavar="BODY",
            callback=body_or_phantom,
            autocompletion=body_names,
            help="A phantom (as --phantom), log, or log-with-phantom, whose first rows show a phantom.",
        ),
    ],
    output: shared.Result,
    scanner: Annotated[ScannerConstants, Flags(**shared.PUBLISHED_SCANNER, row_pitch_mm={"default": 2.0})],
    theta: Annotated[Theta | None, ThetaFlag] = None,
    pairs: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE", exists=True, dir_okay=False, help="Fixed pairs, through which a phantom or log passes."
        ),
    ] = None,
    passages: Annotated[int, typer.Option(min=1, max=8, help="Passages through the pairs, each in another roll.")] = 2,
    places_off_mm: Annotated[
        float, typer.Option(min=0, max=100, help="How far the pairs truly stand from the file's places, mm.")
    ] = 0.0,
    data: Annotated[DataKind, option(shared.ScanOptions, "data")] = DataKind.COUNTS,
    angles_deg: Annotated[
        str | None, typer.Option(metavar="START:STEP", help="A full turn from half a step by default.")
    ] = None,
    angles_file: shared.AnglesFile = None,
    views: Annotated[int, option(SimulationOptions, "views", min=3)] = 360,
    rows: Annotated[int, option(SimulationOptions, "rows")] = 1,
    phantom: PhantomText = "l-shape",
    phantom_width_mm: PhantomWidth = None,
    phantom_rows: Annotated[int, typer.Option(min=1, help="Rows of log-with-phantom that show the phantom.")] = 4,
    position_mm: Annotated[
        Position | None,
        typer.Option(parser=position_of, metavar="X,Y", help="Where the phantom stands. By default 0,0."),
    ] = None,
    handedness: Annotated[Handedness, typer.Option(help="From which end it is seen.")] = Handedness.AS_DRAWN,
    rotation: Annotated[Rotation, typer.Option(help="Which way the angles count.")] = Rotation.AS_GIVEN,
    noise: Annotated[float, option(SimulationOptions, "noise")] = 0.0,
    background: Annotated[float, option(SimulationOptions, "background")] = 0.0,
    photons: Annotated[float, option(SimulationOptions, "photons")] = 30_000.0,
    seed: Annotated[int, option(SimulationOptions, "seed")] = 1,
    physics: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            exists=True,
            dir_okay=False,
            help="Of counts: JSON of what the beam, the detector, the motion and the wood add (docs/do/simulate.md).",
        ),
    ] = None,
) -> None:
    """Simulate a scan of a phantom or a synthetic log, analytically, seeded."""
    from sawmill_formats.input.angles import AngleSteps

    angles = shared.given_angles(angles_deg, angles_file) or AngleSteps(180.0 / views, 360.0 / views)
    if body == PhantomShape.LOG_WITH_PHANTOM and phantom_rows >= rows:
        raise typer.BadParameter(f"--phantom-rows {phantom_rows} leaves no row for the log: give more --rows.")
    if physics is not None and data is not DataKind.COUNTS:
        raise typer.BadParameter("--physics makes counts: leave --data line-integrals out.")
    drawn = phantom if body in set(PhantomShape) else body
    check_width(drawn, phantom_width_mm)
    if pairs is not None:
        sizes = {"passages": passages, "rows": rows, "row_pitch_mm": scanner.row_pitch_mm or 2.0}
        made = {"off_mm": places_off_mm, "photons": photons, "seed": seed}
        _write_passages(pairs, body, handedness, phantom_width_mm, physics, output=output, **sizes, **made)
        return
    if theta is None:  # which `OfGeometry` refuses
        return
    with answering():
        import numpy as np

        from sawmill_calibration import simulation
        from sawmill_calibration.known_geometry import drawing_of
        from sawmill_tomography.geometry.geometry import FanBeamGeometry
        from sawmill_tomography.phantoms.log_model import log_slices

        wood = 0 if body == PhantomShape.LOG else phantom_rows if body == PhantomShape.LOG_WITH_PHANTOM else rows
        as_wood = data is DataKind.COUNTS or body == PhantomShape.LOG_WITH_PHANTOM
        place, pitch = position_mm or Position(), scanner.row_pitch_mm
        drawing = drawing_of(drawn, phantom_width_mm)
        slices = simulation.phantom_slices(drawing, wood, handedness, (place.x, place.y), as_wood=as_wood)
        slices += log_slices(rows, row_pitch_mm=pitch or 0.0, seed=seed)[wood:]
        angles_rad = np.deg2rad(angles.expand(views))
        body_seen = output, slices, FanBeamGeometry(scanner, theta, rotation.apply(angles_rad)), angles_rad
        if data is DataKind.LINE_INTEGRALS:
            simulation.write_line_integrals(
                *body_seen, noise=noise, background=background, seed=seed, row_pitch_mm=pitch
            )
        else:
            effects = None if physics is None else simulation.read_physics(physics)
            simulation.write_counts(*body_seen, effects, photons=photons, seed=seed, row_pitch_mm=pitch)
    say(f"{views} views, {rows} row(s), {scanner.num_detector_pixels} cells: {output}")


def _write_passages(
    pairs: Path,
    body: str,
    handedness: Handedness,
    width_mm: float | None,
    physics: Path | None,
    *,
    output: Path,
    **settings: Any,  # noqa: ANN401 - of `write_passages`
) -> None:
    """Simulate passages of a phantom or a log through fixed pairs, a file for each."""
    if body == PhantomShape.LOG_WITH_PHANTOM:
        raise typer.BadParameter(f"--pairs passes a phantom or a log, not {body!r}: pass them one after the other.")
    with answering():
        from sawmill_calibration import simulation
        from sawmill_calibration.calibration.fixed_pairs import read_paired_scanner
        from sawmill_calibration.known_geometry import drawing_of

        drawn = None
        if body != PhantomShape.LOG:
            [drawn] = simulation.phantom_slices(drawing_of(body, width_mm), 1, handedness, (0.0, 0.0), as_wood=True)
        effects = None if physics is None else simulation.read_physics(physics)
        files = simulation.write_passages(output, drawn, read_paired_scanner(pairs), effects, **settings)
    say(f"{settings['passages']} passages, {settings['rows']} row(s): {', '.join(map(str, files))}")
