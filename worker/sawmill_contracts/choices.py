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
        Field(description="pass: within tolerance, nothing speaks against it. watch: look at it. fail: do not use it."),
    ],
)
Weighting = TypeAliasType(
    "Weighting",
    Annotated[
        vocabulary.Weighting, Field(description="exact: cosine and distance weights. none: neither, as published.")
    ],
)
PaperObjective = TypeAliasType(
    "PaperObjective", Annotated[vocabulary.PaperObjective, Field(description="What the published search compares.")]
)
PaperCorrelation = TypeAliasType(
    "PaperCorrelation",
    Annotated[vocabulary.PaperCorrelation, Field(description="Whether the published search's correlation is normed.")],
)
PaperStop = TypeAliasType(
    "PaperStop", Annotated[vocabulary.PaperStop, Field(description="When the published search ends.")]
)
WitnessTaken = TypeAliasType(
    "WitnessTaken", Annotated[vocabulary.WitnessTaken, Field(description="Whose u_c and tilt are reported.")]
)
MetalTreatment = TypeAliasType(
    "MetalTreatment",
    Annotated[
        Literal["interpolated", "left-out"],
        Field(description="Rays through metal were interpolated along the detector, or left out of the fit."),
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
            description="opposite-rays: every ray against the one from the other side, in dense scans all round. "
            "view-pairs: what any two views have in common, in scans of 8 views or more, and opposite rays as far as "
            "those views have them."
        ),
    ],
)
DriftReference = TypeAliasType(
    "DriftReference",
    Annotated[
        Literal["calibration", "baseline", "given-geometry"],
        Field(
            description="calibration: changes are absolute, counted from the calibration. baseline: they are counted "
            "from what the first logs after it measured. given-geometry: from nominal distances, which have no error "
            "bars; the service compares with calibrations alone."
        ),
    ],
)
DriftFindingKind = TypeAliasType(
    "DriftFindingKind",
    Annotated[
        Literal["learning", "quiet", "jump", "trend"],
        Field(
            description="learning: the baseline is not complete. quiet: nothing speaks against an unchanged scanner. "
            "jump: it moved at one time. trend: it has been moving since."
        ),
    ],
)
OnPass = TypeAliasType(
    "OnPass",
    Annotated[
        Literal["report", "activate"], Field(description="report: nothing more is done. activate: it becomes active.")
    ],
)
ScheduleKind = TypeAliasType(
    "ScheduleKind",
    Annotated[
        Literal["recalibrate", "check-drift"],
        Field(
            description="recalibrate: with the newest phantom scan that no schedule has used. check-drift: on the "
            "newest log scan that no drift check has looked at."
        ),
    ],
)
ScheduleOutcome = TypeAliasType(
    "ScheduleOutcome",
    Annotated[
        Literal["queued", "no-new-phantom-scan", "no-new-log-scan", "no-active-calibration"],
        Field(
            description="A job was queued, or there was no new scan for it, or no active calibration to compare a log "
            "with."
        ),
    ],
)
UnfinishedState = TypeAliasType(
    "UnfinishedState",
    Annotated[
        Literal["queued", "running", "failed", "cancelled"],
        Field(description="A job's states but `succeeded`: those in which there is no answer."),
    ],
)
