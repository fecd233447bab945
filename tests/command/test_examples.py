"""The examples of a new data folder: recorded files, and the resources that are made of them."""

from contextlib import closing

import h5py
import numpy as np
import pytest

from sawmill_command.examples import record
from sawmill_command.seeding import PHANTOM_FILE, RECORDED, STACK_FILE, seed_examples
from sawmill_platform.settings import StorageSettings
from sawmill_store.store import Store

MOST_BYTES = 5 * 2**20
COUNTS = "entry/instrument/detector/data"


def test_the_examples_are_made_once_in_the_life_of_a_data_folder(tmp_path):
    with closing(Store.open(StorageSettings(data_folder=tmp_path, database_url=None))) as store:
        seed_examples(store)
        assert {each.id for each in store.scanners.page().items} == {"example", "example-spare"}
        (tmp_path / "examples/complete").unlink()
        seed_examples(store)  # after an interruption
        assert len(store.scans.page().items) == 2
        assert (tmp_path / "examples" / PHANTOM_FILE).read_bytes() == (RECORDED / PHANTOM_FILE).read_bytes()
    assert sum(path.stat().st_size for path in RECORDED.iterdir()) < MOST_BYTES


@pytest.mark.nightly
def test_the_recorded_files_are_those_that_the_simulator_makes(tmp_path):
    record(tmp_path)
    with h5py.File(tmp_path / STACK_FILE) as made, h5py.File(RECORDED / STACK_FILE) as recorded:
        assert_as_simulated(made[COUNTS][()], recorded[COUNTS][()])
    with np.load(tmp_path / PHANTOM_FILE) as made, np.load(RECORDED / PHANTOM_FILE) as recorded:
        assert_as_simulated(made["projections"], recorded["projections"])


def assert_as_simulated(made, recorded):
    """Another machine rounds the mean of a count differently now and then, and draws another photon."""
    assert made.shape == recorded.shape
    assert np.mean(made != recorded) < 1e-3
