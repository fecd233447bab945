"""The table of reconstruction methods: a new one is a file and a line here."""

from collections.abc import Mapping
from types import MappingProxyType

from sawmill_tomography.reconstruction.cauchy_map import CauchyMap
from sawmill_tomography.reconstruction.fbp import FilteredBackProjection
from sawmill_tomography.reconstruction.method import Method
from sawmill_tomography.reconstruction.tikhonov import Tikhonov
from sawmill_tomography.reconstruction.total_variation import TotalVariation
from sawmill_vocabulary import ReconstructionMethod

METHODS: Mapping[ReconstructionMethod, type[Method]] = MappingProxyType(
    {
        ReconstructionMethod.FBP: FilteredBackProjection,
        ReconstructionMethod.TIKHONOV: Tikhonov,
        ReconstructionMethod.CAUCHY_MAP: CauchyMap,
        ReconstructionMethod.TOTAL_VARIATION: TotalVariation,
    }
)
