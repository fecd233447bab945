"""Preparation of a scan on reading: from the raw stack to the sinograms that everything else uses."""

from pydantic import Field

from sawmill_platform.contracts.base import Contract
from sawmill_vocabulary import AirCorrection, FaultyCells, RingRemoval, RowAlignment


class PrepareOptions(Contract):
    """Corrections of the data on reading. Counts are prepared; declared line integrals are used as they are."""

    air: AirCorrection = Field(
        AirCorrection.AUTO,
        description="Level of the air at the detector's ends: one constant a row (background), or one for each view "
        "where the level drifts (views). auto: views for counts, off for line integrals.",
        examples=["auto"],
    )
    faulty_cells: FaultyCells = Field(
        FaultyCells.AUTO,
        description="Dead and hot cells: bridged from their neighbours, or kept. auto: bridge counts, keep line "
        "integrals.",
        examples=["auto"],
    )
    rings: RingRemoval = Field(
        RingRemoval.OFF,
        description="Remove rings that unequal cells leave; growth rings about the rotation centre are weakened too.",
        examples=["off"],
    )
    align_rows: RowAlignment = Field(
        RowAlignment.OFF,
        description="Alignment of views that lost rows at the top or bottom (NaN, in counts also zero): along the log "
        "by their profile of row sums, or by features matched between views.",
        examples=["off"],
    )
