"""Literals under names of their own: a client that is generated from the contract has one type for each of them."""

from typing import Annotated, Literal

from pydantic import Field
from typing_extensions import TypeAliasType

import sawmill_vocabulary as vocabulary

Axis = TypeAliasType("Axis", Annotated[vocabulary.TrueAxis, Field(description="An axis of the image.")])
Verdict = TypeAliasType(
    "Verdict",
    Annotated[
        vocabulary.Verdict,
        Field(description="pass: within tolerance, nothing speaks against it. watch: inspect it. fail: do not use it."),
    ],
)
Weighting = TypeAliasType(
    "Weighting",
    Annotated[
        vocabulary.Weighting, Field(description="exact: cosine and distance weights. none: neither, as published.")
    ],
)
PaperObjective = TypeAliasType(
    "PaperObjective",
    Annotated[vocabulary.PaperObjective, Field(description="Quantity that the published search compares.")],
)
PaperCorrelation = TypeAliasType(
    "PaperCorrelation",
    Annotated[vocabulary.PaperCorrelation, Field(description="Normalisation of the published search's correlation.")],
)
PaperStop = TypeAliasType(
    "PaperStop", Annotated[vocabulary.PaperStop, Field(description="Stopping rule of the published search.")]
)
UsedEstimate = TypeAliasType(
    "UsedEstimate", Annotated[vocabulary.UsedEstimate, Field(description="Source of the reported u_c and tilt.")]
)
MetalTreatment = TypeAliasType(
    "MetalTreatment",
    Annotated[
        Literal["interpolated", "left-out"],
        Field(
            description="interpolated: rays through metal were interpolated along the detector. left-out: they were "
            "left out of the fit; those through thin metal may have a small weight."
        ),
    ],
)
DisturbedPart = TypeAliasType(
    "DisturbedPart",
    Annotated[
        Literal["encoder", "bearing"],
        Field(description="encoder: the angles run ahead and behind. bearing: the log swings across the beam."),
    ],
)
DriftMethod = TypeAliasType(
    "DriftMethod",
    Annotated[
        Literal["opposite-rays", "view-pairs"],
        Field(
            description="opposite-rays: each ray is compared with its conjugate ray, in dense scans all round. "
            "view-pairs: any two views are compared in what they have in common, in scans of 8 views or more, and "
            "conjugate rays as far as the views contain them."
        ),
    ],
)
DriftReference = TypeAliasType(
    "DriftReference",
    Annotated[
        Literal["calibration", "baseline", "given-geometry"],
        Field(
            description="calibration: changes are absolute, counted from the calibration. baseline: changes are "
            "counted from the mean of the first logs after it. given-geometry: changes are counted from nominal "
            "distances, which have no error bars; the service compares with calibrations alone."
        ),
    ],
)
DriftFindingKind = TypeAliasType(
    "DriftFindingKind",
    Annotated[
        Literal["learning", "quiet", "jump", "trend"],
        Field(
            description="learning: the baseline is not complete. quiet: nothing speaks against an unchanged scanner. "
            "jump: the scanner moved at one time. trend: the scanner has been moving since."
        ),
    ],
)
OnPass = TypeAliasType(
    "OnPass",
    Annotated[
        Literal["report", "activate"],
        Field(description="report: nothing more is done. activate: the calibration becomes active."),
    ],
)
ScheduleKind = TypeAliasType(
    "ScheduleKind",
    Annotated[
        Literal["recalibrate", "check-drift"],
        Field(
            description="recalibrate: calibrate with the newest phantom scan that no schedule has used. check-drift: "
            "check the newest log scan that has no drift check."
        ),
    ],
)
ScheduleOutcome = TypeAliasType(
    "ScheduleOutcome",
    Annotated[
        Literal["queued", "no-new-phantom-scan", "no-new-log-scan", "no-active-calibration"],
        Field(
            description="A job was queued, or there was no new scan to process, or no active calibration to compare a "
            "log with."
        ),
    ],
)
UnfinishedState = TypeAliasType(
    "UnfinishedState",
    Annotated[
        Literal["queued", "running", "failed", "cancelled"],
        Field(description="States of a job that has no answer: all but `succeeded`."),
    ],
)
