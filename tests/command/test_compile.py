"""`sawmill compile`, in processes of their own, and the examples of a new data folder: recorded files."""

import os
import subprocess
import sys
from contextlib import closing
from importlib.util import cache_from_source
from pathlib import Path

import h5py
import numpy as np
import pytest
from example_files import record

import sawmill_service
import sawmill_worker
from sawmill_command.seeding import PHANTOM_FILE, RECORDED, RECORDED_LOG, RECORDED_PAIRS, STACK_FILE, seed_examples
from sawmill_platform.settings import StorageSettings
from sawmill_store.store import Store
from sawmill_tomography.warm_up import PARTS
from sawmill_worker.commands.compile import bytecode_folders, compile_bytecode, compile_kernels

pytestmark = pytest.mark.slow

COMMAND = [sys.executable, "-m", "sawmill_command.commands", "compile"]


@pytest.mark.nightly
def test_what_is_compiled_once_is_loaded_the_next_time(tmp_path):
    """One kernel of the calibration stands for all: compiling a whole part takes a quarter of a minute."""
    program = """
import os
from numba.core import event
from sawmill_tomography.warm_up import _scan

class Count(event.Listener):
    times = 0
    def on_start(self, started):
        Count.times += started.data["dispatcher"].py_func.__module__.startswith("sawmill_")
    def on_end(self, ended): pass

event.register("numba:compile", Count())
for _ in range(2):  # each in a process of its own, of one interpreter
    child = os.fork()
    if not child:
        _scan(4)
        print(Count.times, flush=True)
        os._exit(0)
    os.waitpid(child, 0)
"""
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}
    done = subprocess.run([sys.executable, "-c", program], env=environment, capture_output=True, text=True, check=True)
    first, second = map(int, done.stdout.split())
    assert first > 0
    assert second == 0


def test_the_command_compiles_every_part_and_prints_nothing_where_nobody_looks(run, monkeypatch):
    """The other tests run the parts, and a part in a process."""
    compiled = []
    monkeypatch.setattr(sawmill_worker.commands.compile, "_compile", compiled.append)
    assert run("compile").output == ""
    assert sorted(compiled) == sorted(PARTS)


def test_the_parts_call_every_kernel_that_a_job_could_not_keep():
    program = """
from importlib import import_module
from pkgutil import walk_packages
import sawmill_tomography as tomography
from sawmill_tomography.kernel_cache import _is_cached
from sawmill_tomography.warm_up import PARTS

for part in PARTS.values():
    part()
for found in walk_packages(tomography.__path__, "sawmill_tomography."):
    if found.name.endswith("_numba"):
        for name, kernel in vars(import_module(found.name)).items():
            if _is_cached(kernel) and not kernel.signatures:
                print(name)
"""
    assert subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True).stdout == ""


def test_every_part_is_reported_and_a_failure_is_no_silence(capfd):
    progress = []
    compile_kernels(progress.append, ["slices"])
    assert [(one.fraction, one.stage) for one in progress] == [(0.0, "slices"), (1.0, "done")]
    assert capfd.readouterr() == ("", ""), "nothing is printed"
    with pytest.raises(subprocess.CalledProcessError):
        compile_kernels(progress.append, ["no such part"])


def test_byte_code_of_our_code_and_of_the_libraries_is_compiled_where_it_is_missing(tmp_path):
    for name, text in (("whole.py", "ANSWER = 1"), ("template.py", "{{ no Python }}")):
        (tmp_path / name).write_text(text)
    compile_bytecode([str(tmp_path)])
    assert Path(cache_from_source(str(tmp_path / "whole.py"))).is_file()
    assert not Path(cache_from_source(str(tmp_path / "template.py"))).exists()
    for package in (sawmill_service, sawmill_worker, np):
        assert {str(folder) for folder in Path(package.__file__).parents} & bytecode_folders()


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
    for name in (STACK_FILE, *RECORDED_PAIRS.values(), *RECORDED_LOG.values()):
        with h5py.File(tmp_path / name) as made, h5py.File(RECORDED / name) as recorded:
            assert_as_simulated(made[COUNTS][()], recorded[COUNTS][()])
    with np.load(tmp_path / PHANTOM_FILE) as made, np.load(RECORDED / PHANTOM_FILE) as recorded:
        assert_as_simulated(made["projections"], recorded["projections"])


def assert_as_simulated(made, recorded):
    """Another machine rounds the mean of a count differently now and then, and draws another photon."""
    assert made.shape == recorded.shape
    assert np.mean(made != recorded) < 1e-3
