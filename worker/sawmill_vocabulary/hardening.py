"""The hardening of the beam that a calibration found: contracts take it as a field, the science computes with it."""

from dataclasses import dataclass, field

from sawmill_vocabulary.as_contract import AsContract


@dataclass(frozen=True)
class BeamHardening(AsContract):
    """Beam hardening: a line integral p of the unhardened beam is measured as ln(1 + spread p) / spread.

    Formula and source: docs/understand/reconstruction.md#beam-hardening.
    """

    spread: float = field(
        metadata={
            "description": "Relative variance of the attenuation over the beam's spectrum, divided by the unit of a "
            "line integral.",
            "gt": 0,
            "examples": [0.35],
        }
    )
    longest: float = field(
        metadata={
            "description": "Measured line integral of the phantom's longest path, in the unit of a line integral: "
            "larger ones are extrapolated.",
            "gt": 0,
            "examples": [2.1],
        }
    )
    from_counts: bool = field(
        metadata={
            "description": "Whether the calibration's line integrals were made from counts: only a scan of the same "
            "kind is corrected.",
            "examples": [True],
        }
    )
