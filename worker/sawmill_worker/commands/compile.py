"""Compilation of the numerical kernels, several parts at a time, and of the byte code."""

import compileall
import os
import subprocess
import sys
import sysconfig
from collections.abc import Collection, Iterable
from concurrent.futures import ThreadPoolExecutor, as_completed

from sawmill_formats import hdf5_chunks
from sawmill_tomography.warm_up import PARTS
from sawmill_vocabulary import Progress, ProgressCallback
from sawmill_worker.software import code_folders


def compile_kernels(on_progress: ProgressCallback, parts: Collection[str] = PARTS.keys()) -> None:
    """Compile parts of the science that are not cached yet, one process per part and core at a time."""
    on_progress(Progress(fraction=0.0, stage=", ".join(parts)))
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        compiled = {pool.submit(_compile, part): part for part in parts}
        remaining = list(parts)
        # The byte code takes half a second, while the kernels are compiled.
        hdf5_chunks.load_kernels()
        for future in as_completed(compiled):
            future.result()
            remaining.remove(compiled[future])
            on_progress(Progress(fraction=1.0 - len(remaining) / len(parts), stage=", ".join(remaining) or "done"))


def compile_bytecode(folders: Iterable[str]) -> None:
    """Compile the byte code of all modules in folders, which an editable installation does not have."""
    for folder in folders:
        compileall.compile_dir(folder, quiet=2)


def bytecode_folders() -> set[str]:
    """Find the folders of the product's code and of the libraries."""
    return {sysconfig.get_path("purelib"), sysconfig.get_path("platlib"), *map(str, code_folders())}


def _compile(part: str) -> None:
    subprocess.run([sys.executable, "-m", "sawmill_tomography.warm_up", part], check=True)  # noqa: S603 - the product itself
