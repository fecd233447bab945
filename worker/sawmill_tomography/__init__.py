"""The science: fan-beam geometry, phantoms, projection, reconstruction, calibration. Knows no files and no queue."""

import os

# GNU OpenMP reads it when Numba loads it, with the first parallel kernel. Threads that wait for each other by keeping a
# core busy make one another late where other processes want the cores: total variation took five times as long. Threads
# that sleep at once are woken so late on an idle machine that two were slower than one. These try 300 times, some
# microseconds, before they sleep (`benchmarks/slice_price.py`: 15 ms a slice instead of 22; beside a busy process 30
# instead of 25, and 35 with 1000).
if "OMP_WAIT_POLICY" not in os.environ:
    os.environ["OMP_WAIT_POLICY"] = "passive"
    os.environ.setdefault("GOMP_SPINCOUNT", "300")
