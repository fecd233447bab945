"""Every method of the table gives one Estimate, for a block as for a slice."""

import sys

import numpy as np
import pytest

from sawmill_contracts.reconstructions import MethodReport
from sawmill_tomography.geometry.geometry import FanBeamGeometry, Scanner, Theta
from sawmill_tomography.geometry.image_grid import ImageGrid
from sawmill_tomography.phantoms.phantom import Disc, Phantom
from sawmill_tomography.projection.projector import Projector
from sawmill_tomography.projection.simulate import simulate_sinogram
from sawmill_tomography.reconstruction.choosing import METHODS
from sawmill_tomography.reconstruction.method import DirectMethod

SIZE, SLICES = 24, 3
# 2 % of the lines, about.
NOISE = np.full((1, 1, 1), 0.05)
LOG = Phantom("log", (Disc((5.0, -8.0), 110.0, 0.018), Disc((0.0, 0.0), 60.0, 0.006)))
# The parameters that each method reports.
PARAMETERS = {
    "fbp": set(),
    "tikhonov": {"alpha"},
    "cauchy_map": {"sigma", "beta"},
    "total_variation": {"weight", "coupling"},
}


@pytest.fixture
def projector(full_turn):
    geometry = FanBeamGeometry(Scanner(860.0, 96, 10.5), Theta(0.7, 700.0, 80.0, 20.0, 0.1), full_turn(20))
    return Projector(geometry, ImageGrid(SIZE, 400.0))


@pytest.fixture
def block(projector):
    slices = [simulate_sinogram(LOG, projector.geometry, noise=0.02, seed=1500 + n) for n in range(SLICES)]
    return projector.block(np.stack(slices))


def check(found, slices, shape, parameters):
    assert found.image.shape == shape
    assert found.image.dtype == np.float32
    assert found.iterations.shape == found.converged.shape == (slices,)
    assert found.converged.all()
    assert set(found.parameters) == parameters
    assert parameters <= MethodReport.model_fields.keys(), (
        "add the fields to sawmill_contracts/reconstructions.py: MethodReport"
    )
    assert all(values.shape in {(slices,), (1,)} for values in found.parameters.values())


def function_of(name):
    """The function of a method, which stands in the module of its class."""
    return getattr(sys.modules[METHODS[name].__module__], name)


@pytest.mark.slow
@pytest.mark.parametrize("name", METHODS)
def test_a_block_through_the_table(projector, block, name):
    method = METHODS[name]()
    if isinstance(method, DirectMethod):
        found = method.reconstruct(projector, block)
        assert found.misfit is None
    else:
        shares = []
        found = method.reconstruct(projector, block, noise=NOISE, on_progress=shares.append)
        assert shares == sorted(shares)
        assert found.misfit.shape == (SLICES,)
        assert found.noise > 0.0
    check(found, SLICES, (SLICES, SIZE, SIZE), PARAMETERS[name])


@pytest.mark.parametrize("name", METHODS)
def test_a_slice_through_the_function(projector, block, name):
    check(function_of(name)(projector, block[0]), 1, (SIZE, SIZE), PARAMETERS[name])


@pytest.mark.parametrize("name", ["cauchy_map", "total_variation"])
def test_a_method_with_its_choice_made_reconstructs_as_the_function_with_what_was_chosen(projector, block, name):
    def silent(_share):
        """No progress."""

    chosen = METHODS[name]().chosen(projector, block[1], noise=NOISE, on_progress=silent)
    assert not chosen.is_open
    found = chosen.reconstruct(projector, block, noise=NOISE, on_progress=silent)
    # The function chooses from the middle slice too, on the support region of the whole block.
    for parameter, values in function_of(name)(projector, block).parameters.items():
        assert found.parameters[parameter] == pytest.approx(values, rel=0.2)
