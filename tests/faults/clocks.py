"""Wall clocks that are wrong, a process each (`clock.c`)."""

import shutil
import struct
import subprocess
from pathlib import Path

from tests.faults.servers import NotHere


class Clocks:
    """The clocks of all processes that are started with `variables`."""

    def __init__(self, folder: Path) -> None:
        compiler = shutil.which("cc")
        if compiler is None:
            raise NotHere("no C compiler `cc` is here, which the clocks' shim needs")
        folder.mkdir(parents=True)
        self._folder = folder
        library = folder / "clock.so"
        source = Path(__file__).with_name("clock.c")
        subprocess.run([compiler, "-O2", "-shared", "-fPIC", "-o", str(library), str(source)], check=True)
        self.variables = {"LD_PRELOAD": str(library), "PYTHON_FAULTS_CLOCKS": str(folder)}

    def step(self, process_id: int, offset_s: float) -> None:
        """Shift one process's clock by this offset from now on."""
        path = self._folder / str(process_id)
        if path.exists():
            with path.open("r+b") as file:  # the file is mapped: never truncate
                file.write(struct.pack("d", offset_s))

    def step_all(self, offset_s: float) -> None:
        """Shift the clocks of all processes, also later ones, as a step of the machine's clock does."""
        (self._folder / "start").write_bytes(struct.pack("d", offset_s))
        for path in self._folder.iterdir():
            if path.name.isdigit():
                self.step(int(path.name), offset_s)
