"""Effects that a mill adds to an ideal scan: of the beam, the detector, the motion and the wood. By default none.

Each size is typed here once, with its unit and its bounds: the simulation computes with these classes, and a JSON file
with them is read with the same fields.
"""

from dataclasses import dataclass, field
from typing import Literal

from sawmill_vocabulary.outlines import AsContract, described


def _size(description: str, low: float, high: float, default: float = 0.0) -> float:
    return field(default=default, metadata=described(description, ge=low, le=high))


def _count(description: str, high: int) -> int:
    return field(default=0, metadata=described(description, ge=0, le=high))


def _direction(description: str) -> float:
    return _size(description, -360.0, 360.0)


@dataclass(frozen=True)
class BeamEffects(AsContract):
    """Effects of the source, and on the beam's way."""

    energy_spread: float = _size(
        "Three energies attenuate by 1 + s, 1 and 1 - s times the stated attenuation: the beam hardens.", 0, 0.6
    )
    scatter_share: float = _size("Share of the photons that wood takes out of the beam and spreads over it.", 0, 0.5)
    scatter_width_mm: float = _size("Standard deviation of the scattered halo on the detector.", 1, 1000, 90.0)
    focal_blur_mm: float = _size(
        "Standard deviation of the focal spot's image, on the detector, of a point at the rotation centre.", 0, 10
    )
    drift_share: float = _size("Change of the tube's output from the first view to the last.", -0.5, 0.5)
    flicker_share: float = _size("Standard deviation of the tube's output from view to view.", 0, 0.5)
    past_end_share: float = _size("Share of the row's beam that passes beyond the board's end.", 0, 0.99)
    row_share: float = _size("Share of the stated photons that a thin row collects.", 1e-3, 1, 1.0)


@dataclass(frozen=True)
class DetectorEffects(AsContract):
    """Effects of the detector's cells and its electronics."""

    blur_mm: float = _size("Standard deviation of the scintillator's blur.", 0, 10)
    glare_share: float = _size("Share of a cell's light that spreads over the others, in flat fields too.", 0, 0.5)
    glare_width_mm: float = _size("Standard deviation of the glare.", 1, 1000, 90.0)
    lag_share: float = _size("Share of a view's signal that the next view still shows.", 0, 0.5)
    slope_share: float = _size("Change of the gain since the flat fields, from the first cell to the last.", -0.5, 0.5)
    curvature_share: float = _size(
        "Change of the gain since the flat fields, from the middle of the detector to its ends.", -0.5, 0.5
    )
    gain_spread: float = _size("Standard deviation of the cells' gains, in flat fields too.", 0, 0.3)
    dead_cells: int = _count("Cells that have shown their dark level since the flat fields.", 1000)
    hot_cells: int = _count("Cells whose gain has changed by up to 30 % since the flat fields.", 1000)
    bits: Literal[12, 16] = field(default=16, metadata=described("Number of bits of the converter: 12 or 16."))
    air_of_full_scale: float | None = field(
        default=None,
        metadata=described(
            "Counts in air against the largest value of the converter; above 1 air is saturated. "
            "Default: one count a photon with 16 bits, 0.8 with 12.",
            gt=0,
            le=2,
        ),
    )


@dataclass(frozen=True)
class MotionEffects(AsContract):
    """Effects of the turntable, its encoder, and the phantom's mounting."""

    slip_mm: float = _size("Distance that the phantom slips.", 0, 50)
    slip_towards_deg: float = _direction("Direction of the slip in the image.")
    slip_turn_deg: float = _size("Angle that the phantom turns when it slips.", -20, 20)
    slip_at: float = _size("Share of the views before the slip.", 0, 1, 0.5)
    wobble_once_mm: float = _size("Amplitude of a displacement once a turn, along a line of the hall.", 0, 20)
    wobble_twice_mm: float = _size("Amplitude of a displacement twice a turn, along the same line of the hall.", 0, 20)
    wobble_towards_deg: float = _direction(
        "Direction of the line of displacement, against the detector's side of the beam."
    )
    wobble_phase_deg: float = _direction("View angle at which the displacement is largest.")
    creep_mm: float = _size("Distance that the phantom creeps from the first view to the last.", 0, 50)
    creep_towards_deg: float = _direction("Direction of the creep in the image.")
    encoder_deg: float = _size("Amplitude of the encoder's error once a turn.", 0, 20)
    encoder_phase_deg: float = _direction("View angle at which the encoder's error is largest.")
    angle_jitter_deg: float = _size("Standard deviation of each view's angle.", 0, 5)
    pace_percent: float = _size("Excess of the turntable's turn over the recorded angles.", -10, 10)
    exposure_steps: float = _size("Share of the step between views over which a view is exposed.", 0, 1)


@dataclass(frozen=True)
class WoodEffects(AsContract):
    """Differences of the phantom from its drawing."""

    size_percent: float = _size("Excess of the phantom's size over the drawing's.", -10, 10)
    aspect_percent: float = _size("Excess of the phantom's length along x over that along y.", -10, 10)
    shear_percent: float = _size("Shear of the phantom: displacement along x for each length along y.", -10, 10)
    plane_tilt_deg: float = _size(
        "Tilt of the phantom's plane against the plane of the rays: 1 / cos longer along one line.", 0, 30
    )
    plane_tilt_towards_deg: float = _direction(
        "Direction in the image of the line along which the tilted phantom is longer."
    )
    corner_radius_mm: float = _size("Radius of all corners of the phantom.", 0, 40)
    roughness_mm: float = _size("Standard deviation of the phantom's sawn sides.", 0, 5)
    ring_contrast: float = _size("Excess of late wood's density, relative to early wood's.", 0, 1)
    ring_spacing_mm: float = _size("Distance between growth rings; 3/8 of it is late wood.", 2, 50, 8.0)
    knots: int = _count("Number of knots, of 5 to 12 mm radius.", 50)
    knot_contrast: float = _size("Excess of a knot's density, relative to the wood's.", -1, 3, 0.4)
    density_slope_percent: float = _size("Change of the density over 100 mm.", -30, 30)
    density_slope_towards_deg: float = _direction("Direction in the image in which the density grows.")
    screws: int = _count("Number of steel screws or nails in the phantom.", 50)
    screw_diameter_mm: float = _size("Diameter of each screw.", 0.5, 50, 5.0)
    steel_per_mm: float = _size("Attenuation of steel; 0.9 at 60 keV.", 0.01, 5, 0.9)


@dataclass(frozen=True)
class Physics(AsContract):
    """Deviations of a scan from the ideal one; by default none."""

    beam: BeamEffects = field(default=BeamEffects(), metadata=described("Effects of the source and the beam."))
    detector: DetectorEffects = field(default=DetectorEffects(), metadata=described("Effects of the detector."))
    motion: MotionEffects = field(default=MotionEffects(), metadata=described("Effects of turntable and phantom."))
    wood: WoodEffects = field(default=WoodEffects(), metadata=described("Effects of the phantom's wood."))
