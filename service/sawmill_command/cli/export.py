"""`sawmill export`: flags."""
# ruff: noqa: PLC0415 - imports inside the command: its help needs none

from pathlib import Path
from typing import Annotated

import typer

from sawmill_worker.commands import options as shared
from sawmill_worker.commands.geometry_options import CalibrationFlag
from sawmill_worker.commands.terminal import Command, OneOf, answering, say

app = typer.Typer()


class WithAngles(Command):
    """A command that needs the angles of the views."""

    one_of = OneOf(("angles_deg", "angles_file"), "the views' angles")


@app.command(cls=WithAngles)
def export(
    calibration: Annotated[Path, CalibrationFlag],
    to: Annotated[
        shared.ExportTarget,
        typer.Option(
            help="vectors: JSON that --geometry reads; astra: rows srcX srcY dX dY uX uY of fanflat_vec, mm; odl, cil: "
            "JSON of every argument; rtk: XML."
        ),
    ],
    output: shared.Result,
    views: Annotated[int, typer.Option(min=1, help="Number of views.")],
    angles_deg: shared.AnglesDeg = None,
    angles_file: shared.AnglesFile = None,
    flat: Annotated[
        Path | None,
        typer.Option(
            metavar="NPY",
            exists=True,
            dir_okay=False,
            help="Line integrals, last axis cells, which are resampled to the equal cells of a straight detector, for "
            "which the geometry is written. OUT.flat.npy has them.",
        ),
    ] = None,
) -> None:
    """Write a calibrated geometry for another toolkit."""
    angles = shared.given_angles(angles_deg, angles_file)
    assert angles is not None  # noqa: S101 - checked by WithAngles
    with answering():
        from sawmill_worker.commands.export import export_geometry

        export_geometry(to, calibration, output, angles, views, flat)
    say(f"{views} views: {output}")
