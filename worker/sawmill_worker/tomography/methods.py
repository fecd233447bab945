"""The table of reconstruction methods: a new one is a file and a line here."""

from collections.abc import Mapping
from types import MappingProxyType

from sawmill_worker.tomography.cauchy_map import CauchyMap
from sawmill_worker.tomography.fbp import FilteredBackProjection
from sawmill_worker.tomography.method import Method
from sawmill_worker.tomography.tikhonov import Tikhonov
from sawmill_worker.tomography.total_variation import TotalVariation
from sawmill_worker.vocabulary import ReconstructionMethod

METHODS: Mapping[ReconstructionMethod, type[Method]] = MappingProxyType(
    {
        ReconstructionMethod.FBP: FilteredBackProjection,
        ReconstructionMethod.TIKHONOV: Tikhonov,
        ReconstructionMethod.CAUCHY_MAP: CauchyMap,
        ReconstructionMethod.TOTAL_VARIATION: TotalVariation,
    }
)
