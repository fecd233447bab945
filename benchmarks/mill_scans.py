"""The scans of the mill's study: random scanners and phantoms, and the effects with the sizes that a mill has.

A size is drawn evenly in the logarithm, up to the largest that a mill would let pass. The smallest moves the rays of a
plain fit by about 0.01 mm, or less, in the median scan (`benchmarks/mill.py` at 3ab7f653). All scans have cells
whose gains differ by 3 %, ten flats and darks, and a phantom whose size is off by the stated 0.15 % (standard
deviation).
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Literal

import numpy as np
from scanners import CUSTOM, SCANNER, DrawnScanner, draw_scanner, leaves_air

from sawmill_tomography.calibration.task import CalibrationTask
from sawmill_tomography.geometry.geometry import FloatArray, GeometryError, SourceFrame
from sawmill_tomography.phantoms.built_in import L_SHAPE, RECTANGLE_WITH_HOLE
from sawmill_tomography.phantoms.phantom import Disc, Phantom, Polygon
from sawmill_tomography.physics.simulate import MillScan, simulate_physics
from sawmill_tomography.preparing.line_integrals import SATURATION, Exposure, Stack
from sawmill_tomography.preparing.row_corrections import Corrections, RowCorrector
from sawmill_tomography.projection import analytic
from sawmill_tomography.projection.analytic import DetectorCells
from sawmill_vocabulary import AirCorrection
from sawmill_vocabulary.messages import Reason
from sawmill_vocabulary.physics import BeamEffects, DetectorEffects, MotionEffects, Physics, WoodEffects

STEP = Phantom(
    "step with two holes",
    (
        Polygon(((-120.0, -60.0), (90.0, -75.0), (90.0, 20.0), (30.0, 25.0), (30.0, 110.0), (-95.0, 90.0))),
        Disc((50.0, -40.0), 14.0, -1.0),
        Disc((-40.0, 50.0), 20.0, -1.0),
    ),
)
# Standard deviation of the phantom's stated size, percent.
SIZE_PERCENT = 0.15
PHANTOMS = tuple(
    replace(drawing, size_tolerance=SIZE_PERCENT / 100.0) for drawing in (L_SHAPE, RECTANGLE_WITH_HOLE, CUSTOM, STEP)
)
VIEWS = (20, 30, 45, 60, 90, 120, 180, 360)
PHOTONS = (2_000.0, 50_000.0)
# Dry board to green wood.
ATTENUATION_PER_MM = (0.006, 0.018)
GAIN_SPREAD = 0.03
OFF_CENTRE_MM = 10.0
# In whose disc ray errors count, whatever the phantom's reach.
LOG_RADIUS_MM = 150.0
# Air at the detector's ends, in cells, for its level to be seen.
AIR = 14
CELLS = DetectorCells.of(SCANNER)

Kind = Literal["clean", "single", "pair"]
# The effect's fields by group, of a size.
Fields = dict[str, dict[str, Any]]
Draw = Callable[[float, np.random.Generator], Fields]


@dataclass(frozen=True)
class Drawn:
    """An effect of the study: its smallest and largest size, and the physics of a size."""

    low: float
    high: float
    fields: Draw

    def size(self, rng: np.random.Generator) -> float:
        """Draw a size, uniform in the logarithm."""
        return math.exp(rng.uniform(math.log(self.low), math.log(self.high)))


def _field(group: str, name: str, *, signed: bool = False, towards: tuple[str, ...] = ()) -> Draw:
    """Return a function that draws one field, with a random sign or random directions."""

    def fields(size: float, rng: np.random.Generator) -> Fields:
        sign = rng.choice((-1.0, 1.0)) if signed else 1.0
        return {group: {name: float(sign * size)} | {angle: rng.uniform(0.0, 360.0) for angle in towards}}

    return fields


def _either(*draws: Draw) -> Draw:
    def fields(size: float, rng: np.random.Generator) -> Fields:
        return draws[rng.integers(len(draws))](size, rng)

    return fields


def _number(group: str, *names: str, **more: float) -> Draw:
    """Return a function that draws a whole number of something."""

    def fields(size: float, _: np.random.Generator) -> Fields:
        return {group: {name: round(size) for name in names} | more}

    return fields


def _slip(size: float, rng: np.random.Generator) -> Fields:
    """Draw a move, a turn of a tenth of as many degrees, or both."""
    moves, turns = ((True, False), (False, True), (True, True))[rng.integers(3)]
    turn = 0.1 * size * float(rng.choice((-1.0, 1.0)))
    return {
        "motion": {
            "slip_mm": size * moves,
            "slip_turn_deg": turn * turns,
            "slip_towards_deg": rng.uniform(0.0, 360.0),
            "slip_at": rng.uniform(0.1, 0.9),
        }
    }


def _knots(size: float, rng: np.random.Generator) -> Fields:
    return {"wood": {"knots": int(rng.integers(1, 5)), "knot_contrast": size}}


def _screws(size: float, rng: np.random.Generator) -> Fields:
    return {"wood": {"screws": round(size), "steel_per_mm": rng.uniform(0.3, 0.9)}}


DIRECTED = ("wobble_towards_deg", "wobble_phase_deg")
EFFECTS: Mapping[str, Drawn] = {
    "hardening": Drawn(0.05, 0.35, _field("beam", "energy_spread")),
    "scatter": Drawn(
        0.01,
        0.2,
        # Of the light, 1 to 20 %; of the photons that wood takes out, a fourth: a slit is in front of the detector.
        _either(
            _field("detector", "glare_share"),
            lambda size, rng: _field("beam", "scatter_share")(0.25 * size, rng),
        ),
    ),
    "blur": Drawn(0.2, 3.0, _either(_field("detector", "blur_mm"), _field("beam", "focal_blur_mm"))),
    "exposure": Drawn(0.2, 1.0, _field("motion", "exposure_steps")),
    "tube": Drawn(0.005, 0.05, _either(_field("beam", "drift_share", signed=True), _field("beam", "flicker_share"))),
    "past the end": Drawn(0.005, 0.2, _field("beam", "past_end_share")),
    "thin row": Drawn(0.1, 0.8, _field("beam", "row_share")),
    "lag": Drawn(0.005, 0.05, _field("detector", "lag_share")),
    "flat field": Drawn(
        0.003,
        0.03,
        _either(
            _field("detector", "slope_share", signed=True),
            lambda size, rng: _field("detector", "curvature_share", signed=True)(0.5 * size, rng),
        ),
    ),
    "faulty cells": Drawn(1.0, 8.0, _number("detector", "dead_cells", "hot_cells")),
    "12 bits": Drawn(12.0, 12.0, _number("detector", "bits")),
    "saturation": Drawn(0.97, 1.06, _field("detector", "air_of_full_scale")),
    "slip": Drawn(0.1, 5.0, _slip),
    "wobble once": Drawn(0.05, 1.0, _field("motion", "wobble_once_mm", towards=DIRECTED)),
    "wobble twice": Drawn(0.05, 1.0, _field("motion", "wobble_twice_mm", towards=DIRECTED)),
    "creep": Drawn(0.08, 1.0, _field("motion", "creep_mm", towards=("creep_towards_deg",))),
    "encoder": Drawn(0.02, 0.5, _field("motion", "encoder_deg", towards=("encoder_phase_deg",))),
    "angle jitter": Drawn(0.05, 0.2, _field("motion", "angle_jitter_deg")),
    "pace": Drawn(0.03, 0.5, _field("motion", "pace_percent", signed=True)),
    "aspect": Drawn(
        0.1, 0.5, _either(_field("wood", "aspect_percent", signed=True), _field("wood", "shear_percent", signed=True))
    ),
    "tilted plane": Drawn(1.5, 4.0, _field("wood", "plane_tilt_deg", towards=("plane_tilt_towards_deg",))),
    "corners": Drawn(1.0, 10.0, _field("wood", "corner_radius_mm")),
    "roughness": Drawn(0.1, 0.5, _field("wood", "roughness_mm")),
    "rings": Drawn(0.1, 0.3, _field("wood", "ring_contrast")),
    "knots": Drawn(0.15, 0.5, _knots),
    "density slope": Drawn(0.4, 5.0, _field("wood", "density_slope_percent", towards=("density_slope_towards_deg",))),
    "screws": Drawn(0.51, 4.49, _screws),
}
# Exposed over no more than this: a mill that stops for each view has few of them.
LONGEST_EXPOSURE_RAD = math.radians(2.0)


@dataclass(frozen=True)
class Setting(DrawnScanner):
    """Scanner, phantom and exposure of one scan."""

    frame: SourceFrame
    photons: float
    attenuation_per_mm: float

    @classmethod
    def random(cls, rng: np.random.Generator) -> "Setting":
        """Draw a scanner of the published bounds whose shadow leaves air at both ends of the detector in every view."""
        while True:
            drawn = draw_scanner(rng, PHANTOMS, VIEWS, OFF_CENTRE_MM)
            photons, attenuation = (math.exp(rng.uniform(*np.log(range_))) for range_ in (PHOTONS, ATTENUATION_PER_MM))
            try:
                frame = drawn.theta.source_frame(SCANNER.source_to_cor_mm)
                # Air is left also around a phantom that is larger, or moves, by a few millimetres.
                shadow = analytic.project(drawn.seen.scaled(1.05), CELLS, frame, drawn.rotation.apply(drawn.angles_rad))
            except GeometryError:  # a corner of the bounds that no scanner can be in
                continue
            if leaves_air(shadow, AIR):
                return cls(**vars(drawn), frame=frame, photons=photons, attenuation_per_mm=attenuation)


@dataclass(frozen=True)
class LineIntegrals:
    """A whole scan as the product reads it, block by block."""

    stack: Stack  # (views, rows, detector) float32: line integrals, dimensionless
    saturated_share: float  # `Exposure.saturated_share`
    remarks: tuple[Reason, ...]


def line_integrals(counts: Stack, flats: Stack, darks: Stack | None) -> LineIntegrals:
    """Compute line integrals of counts (views, rows, detector) with flats and darks (fields, rows, detector)."""
    exposure, stack = Exposure.of(flats, darks), counts.astype(np.float32)
    saturated = exposure.saturated_samples(exposure.at_largest(stack).sum(axis=0), float(np.nanmax(stack)))
    starved = int(exposure.to_line_integrals(stack).sum())
    exposure.check_signal(starved, stack.size)
    share = exposure.saturated_share(saturated, len(stack))
    return LineIntegrals(stack, share, exposure.remarks(starved, int(saturated.sum())))


@dataclass(frozen=True)
class StudyScan:
    """A scan of the study, by its number and the study's seed alone."""

    kind: Kind
    sizes: dict[str, float]
    physics: Physics
    setting: Setting
    seed: int

    @classmethod
    def of(cls, number: int, seed: int) -> "StudyScan":
        """Return a scan by its number: of four, one is clean, two have one effect in turn, and one has a pair."""
        rng = np.random.default_rng((seed, number))
        setting = Setting.random(rng)
        names = list(EFFECTS)
        group, place = divmod(number, 4)
        kind: Kind = ("clean", "single", "single", "pair")[place]
        chosen = {
            "clean": [],
            "single": [names[(2 * group + place - 1) % len(names)]],
            "pair": rng.choice(names, 2, replace=False).tolist(),
        }[kind]
        sizes = {name: EFFECTS[name].size(rng) for name in chosen}
        fields = [EFFECTS[name].fields(size, rng) for name, size in sizes.items()]
        physics = _limited(_physics(_base(rng), *fields), setting.angles_rad)
        return cls(kind, sizes, physics, setting, int(rng.integers(2**31)))

    @property
    def ideal(self) -> Physics:
        """The physics without the effects: the phantom's size alone is off."""
        return Physics(wood=WoodEffects(size_percent=self.physics.wood.size_percent))

    def scanned(self, physics: Physics) -> MillScan:
        """Simulate the scanner's record."""
        setting = self.setting
        body = setting.seen.of_density(setting.attenuation_per_mm)
        turned = setting.rotation.apply(setting.angles_rad)
        return simulate_physics(body, SCANNER, setting.frame, turned, physics, photons=setting.photons, seed=self.seed)

    @cached_property
    def recorded(self) -> MillScan:
        """The record with the effects."""
        return self.scanned(self.physics)

    @cached_property
    def read(self) -> LineIntegrals:
        """The counts as the product reads them."""
        taken = (self.recorded.counts, self.recorded.flats, self.recorded.darks)
        return line_integrals(*(one[:, None].astype(np.float32) for one in taken))

    @property
    def remarks(self) -> list[str]:
        """The remarks of the reader that a calibration reports too."""
        return [remark for remark in self.read.remarks if remark.startswith(SATURATION)]

    def task(self) -> CalibrationTask:
        """Return the line integrals as a task, their air corrected as the product corrects it."""
        stack = self.read.stack.copy()
        RowCorrector(Corrections(AirCorrection.VIEWS), 1, stack.shape[2]).correct(stack)
        lines = stack[:, 0].astype(np.float64)
        return CalibrationTask(
            SCANNER,
            self.setting.drawing,
            lines,
            self.setting.angles_rad,
            from_counts=True,
            log_radius_mm=LOG_RADIUS_MM,
            saturated_share=self.read.saturated_share,
        )


def _base(rng: np.random.Generator) -> Fields:
    return {"detector": {"gain_spread": GAIN_SPREAD}, "wood": {"size_percent": SIZE_PERCENT * rng.standard_normal()}}


def _physics(*all_fields: Fields) -> Physics:
    merged: Fields = {}
    for fields in all_fields:
        for group, values in fields.items():
            merged.setdefault(group, {}).update(values)
    return Physics(
        BeamEffects(**merged.get("beam", {})),
        DetectorEffects(**merged.get("detector", {})),
        MotionEffects(**merged.get("motion", {})),
        WoodEffects(**merged.get("wood", {})),
    )


def _limited(physics: Physics, angles_rad: FloatArray) -> Physics:
    """Limit the physics so that no view is exposed over more than a mill would."""
    longest = LONGEST_EXPOSURE_RAD / float(abs(angles_rad[1] - angles_rad[0]))
    share = min(physics.motion.exposure_steps, longest)
    return replace(physics, motion=replace(physics.motion, exposure_steps=share))
