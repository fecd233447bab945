"""`sawmill phantom`: flags and output of the commands."""
# ruff: noqa: PLC0415, FBT002 - imports inside the command: its help needs none; flags are booleans with a default

from typing import Annotated

import typer

from sawmill_contracts.geometry import ScannerConstants
from sawmill_contracts.plans import PlanOptions
from sawmill_contracts.scanners import ScannerSpec
from sawmill_vocabulary import Theta
from sawmill_worker.commands import options as shared
from sawmill_worker.commands.from_contract import Flags, from_contracts, option, wrong_use
from sawmill_worker.commands.geometry_options import ThetaFlag
from sawmill_worker.commands.options import (
    PhantomWidth,
    check_width,
    existing_phantom,
    existing_phantoms,
    phantom_names,
)
from sawmill_worker.commands.terminal import Command, answering, print_json, say

app = typer.Typer()
phantom_app = typer.Typer(no_args_is_help=True)
app.add_typer(phantom_app, name="phantom")


@phantom_app.callback()
def phantom() -> None:
    """Choose a phantom, and draw it."""


@phantom_app.command(cls=Command)
@from_contracts
def plan(
    phantoms: Annotated[
        list[str],
        typer.Argument(
            metavar="PHANTOM...",
            callback=existing_phantoms,
            autocompletion=phantom_names,
            help="What to compare: names or files, as --phantom.",
        ),
    ],
    theta: Annotated[Theta, ThetaFlag],
    scanner: Annotated[ScannerConstants, Flags(**shared.PUBLISHED_SCANNER, row_pitch_mm=None)],
    views: Annotated[
        list[int] | None, typer.Option(min=3, help="Views over a full turn; may be repeated. 20 and 360 by default.")
    ] = None,
    noise: Annotated[float, option(PlanOptions, "noise")] = 0.02,
    size_tolerance_percent: Annotated[float | None, option(PlanOptions, "size_tolerance_percent")] = None,
    log_radius_mm: Annotated[float | None, option(ScannerSpec, "log_radius_mm")] = None,
    phantom_width_mm: PhantomWidth = None,
    as_json: shared.JsonFlag = False,
) -> None:
    """Predict how well phantoms will calibrate a scanner, before they are made."""
    for text in phantoms:
        check_width(text, phantom_width_mm)
    with wrong_use():
        options = [
            PlanOptions(views=count, noise=noise, size_tolerance_percent=size_tolerance_percent)
            for count in views or (20, 360)
        ]
    with answering(as_json=as_json):
        from sawmill_calibration.calibration.plan import run_plan
        from sawmill_calibration.known_geometry import drawing_of

        drawings = [drawing_of(text, phantom_width_mm) for text in phantoms]
        plans = [run_plan(each, scanner, theta, option, log_radius_mm) for each in drawings for option in options]
    if as_json:
        print_json({"state": "succeeded", "plans": [each.model_dump(mode="json") for each in plans]})
    else:
        from sawmill_worker.commands.tables import print_plans

        print_plans(plans)
    for each in plans:
        if each.views_cut_off:
            say(f"{each.phantom}: {each.views_cut_off} of {each.views} views reach an end of the detector")


@phantom_app.command(cls=Command)
def draw(
    phantom: Annotated[
        str,
        typer.Argument(
            metavar="PHANTOM",
            callback=existing_phantom,
            autocompletion=phantom_names,
            help="A name or a file, as --phantom.",
        ),
    ],
    output: shared.Result,
    phantom_width_mm: PhantomWidth = None,
) -> None:
    """Draw a phantom as SVG in mm, to print at full size."""
    check_width(phantom, phantom_width_mm)
    with answering():
        from sawmill_calibration.known_geometry import drawing_of
        from sawmill_calibration.pictures.phantom_drawing import phantom_svg

        output.write_text(phantom_svg(drawing_of(phantom, phantom_width_mm)), encoding="utf-8")
    say(f"{phantom}, to be printed at 100 %: {output}")
