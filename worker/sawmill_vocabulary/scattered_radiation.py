"""The hardening and the scattered radiation that a calibration found: contracts and the science share them."""

from dataclasses import dataclass, field

from sawmill_vocabulary.outlines import AsContract, described


@dataclass(frozen=True)
class BeamHardening(AsContract):
    """Beam hardening: a line integral p of the unhardened beam is measured as ln(1 + spread p) / spread.

    Formula and source: docs/understand/reconstruction.md#beam-hardening.
    """

    spread: float = field(
        metadata=described(
            "Relative variance of the attenuation over the beam's spectrum, divided by the unit of a line integral.",
            gt=0,
            examples=[0.35],
        )
    )
    longest: float = field(
        metadata=described(
            "Measured line integral of the phantom's longest path, in the unit of a line integral: "
            "larger ones are extrapolated.",
            gt=0,
            examples=[2.1],
        )
    )
    from_counts: bool = field(
        metadata=described(
            "Whether the calibration's line integrals were made from counts: only a scan of the same "
            "kind is corrected.",
            examples=[True],
        )
    )


@dataclass(frozen=True)
class ScatteredRadiation(AsContract):
    """Shares of the intensity that the object scatters out of the beam, and that reach the cells from other directions.

    Formula: docs/understand/reconstruction.md#scattered-radiation.
    """

    around: float = field(
        metadata=described(
            "Share that is spread over the neighbouring cells, a number from 0 to 0.5.", ge=0, lt=0.5, examples=[0.04]
        )
    )
    wide: float = field(
        metadata=described(
            "Share that is spread over the whole row, a number from 0 to 0.5.", ge=0, lt=0.5, examples=[0.01]
        )
    )
    width_cells: int = field(
        metadata=described(
            "Number of cells of the running mean that, taken twice, spreads `around`.", gt=0, examples=[45]
        )
    )


@dataclass(frozen=True)
class BeamCorrection:
    """Corrections of line integrals that a calibration found: scattered radiation, then beam hardening."""

    hardening: BeamHardening | None = None
    scatter: ScatteredRadiation | None = None

    @property
    def from_counts(self) -> bool:
        """True if the calibration's line integrals were made from counts; for others no scatter is known."""
        return self.scatter is not None or (self.hardening is not None and self.hardening.from_counts)


NOTHING_FOUND = BeamCorrection()
