"""Options of `calibrate` and `reconstruct`, written by `make docs` from their contracts."""

from collections.abc import Sequence
from typing import Literal, TypedDict

# ruff: noqa: UP013 - short

Adjustment = Literal[
    "faulty-cells", "corrupt-views", "metal", "intensity-averaging", "blur", "outliers", "view-gain",
    "beam-hardening", "density-gradient", "scattered-radiation", "lag", "rotation-during-exposure", "flat-field",
    "modules", "cell-places", "deformation", "bow", "surface-density", "wood-density", "corners", "pace", "creep",
    "slip", "encoder", "wobble", "angle-jitter", "view-poses", "phantom-rows",
]
AlphaRule = Literal["cross-validation", "discrepancy", "gcv", "l-curve"]
Axis = Literal["x", "y"]
CalibrationMethod = Literal["default", "paper"]
FilterName = Literal["ram-lak", "shepp-logan", "cosine", "hamming", "hann"]
Handedness = Literal["as-drawn", "from-behind"]
HardeningHandling = Literal["auto", "none"]
MetalHandling = Literal["auto", "interpolate", "none"]
PaperCorrelation = Literal["unnormalised", "normalised"]
PaperObjective = Literal["image", "projection"]
PaperStop = Literal["published", "tight"]
PoseHandling = Literal["auto", "from-log", "none"]
Preference = Literal["quality", "speed"]
ReconstructionMethod = Literal["fbp", "tikhonov", "cauchy_map", "total_variation", "ring_tv", "auto"]
Rotation = Literal["as-given", "reversed"]
Weighting = Literal["exact", "none"]
PaperOptions = TypedDict(
    "PaperOptions",
    {
        "objective": PaperObjective, "weighting": Weighting, "correlation": PaperCorrelation, "stop": PaperStop,
        "max_generations": int, "image_size": int,
    },
    total=False,
)
CalibrationOptions = TypedDict(
    "CalibrationOptions",
    {
        "rows": str | None, "log_rows": str | None, "views": int | None, "handedness": Handedness | None,
        "rotation": Rotation | None, "method": CalibrationMethod, "seed": int, "rays_per_cell": int | None,
        "without": Sequence[Adjustment], "size_tolerance_percent": float | None, "true_axis": Axis | None,
        "paper": PaperOptions,
    },
    total=False,
)
ReconstructionOptions = TypedDict(
    "ReconstructionOptions",
    {
        "rows": str | None, "views": int | None, "method": ReconstructionMethod, "prefer": Preference,
        "filter": FilterName, "frequency_scaling": float, "weighting": Weighting, "size": int, "field_mm": float,
        "field_centre_mm": tuple[float, float], "metal": MetalHandling, "hardening": HardeningHandling,
        "view_poses": PoseHandling, "alpha": float | None, "alpha_rule": AlphaRule, "sigma": float | None,
        "beta": float | None, "preset": Literal["paper"] | None, "weight": float | None, "ring_weight": float | None,
        "coupling": str | float, "non_negative": bool, "uncertainty": bool,
    },
    total=False,
)
