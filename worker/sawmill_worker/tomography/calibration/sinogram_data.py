"""The scan as least squares sees it: the samples, their weights, and the terms that are fitted beside the shadow."""

from dataclasses import dataclass

from sawmill_worker.tomography import analytic
from sawmill_worker.tomography.analytic import DetectorCells
from sawmill_worker.tomography.fit_parameters import FRAME, MOMENTS, GramTerm, Parameter
from sawmill_worker.tomography.geometry import FloatArray, SourceFrame
from sawmill_worker.tomography.phantom import Phantom


@dataclass(frozen=True)
class SinogramData:
    """What the model is compared with.

    Attributes
    ----------
    sinogram : (views, cells) float64
        Line integrals.
    angles_rad : (views,) float64
        As one sense of rotation reads them.
    cells : DetectorCells
        Where the cells lie.
    rays_per_cell : int or None
        Rays per cell in the model; None averages over the cell.
    weights : (views, cells) float64 or None
        Of each sample; None weighs all alike.
    hardening, density_gradient, view_gain : bool
        Whether p^2, the density's slopes over the phantom, and a gain and offset of each view are fitted beside the
        common gain and offset.
    blur_cells : float
        Standard deviation, in cells, of the model's blur along the detector.
    """

    sinogram: FloatArray
    angles_rad: FloatArray
    cells: DetectorCells
    rays_per_cell: int | None = None
    weights: FloatArray | None = None
    hardening: bool = False
    density_gradient: bool = False
    view_gain: bool = False
    blur_cells: float = 0.0

    @property
    def extras(self) -> list[GramTerm]:
        """The linear terms that are fitted beside gain and offset."""
        return [GramTerm.SHADOW_SQUARED] * self.hardening + MOMENTS * self.density_gradient

    @property
    def samples(self) -> float:
        """Number of samples, by weight."""
        return self.sinogram.size if self.weights is None else float(self.weights.sum())

    def gram(self, phantom: Phantom, x: FloatArray, hardening: float, *, extended: bool | None = None) -> FloatArray:
        """`analytic.gram` at a vector x (7,) in the order of `Parameter`."""
        options = analytic.GramOptions(
            self.weights, bool(self.extras) if extended is None else extended, hardening, self.blur_cells
        )
        return analytic.gram(
            phantom,
            self.cells,
            SourceFrame.from_vector(x[FRAME]),
            self.angles_rad,
            self.sinogram,
            position_mm=(x[Parameter.T_X], x[Parameter.T_Y]),
            rays_per_cell=self.rays_per_cell,
            options=options,
        )
