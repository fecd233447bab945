"""The science: fan-beam geometry, phantoms, projection, reconstruction, calibration. Knows no files and no queue."""

import os

# GNU OpenMP reads it when Numba loads it, with the first parallel kernel. Threads that wait for each other by keeping a
# core busy make one another late where other processes want the cores: total variation took five times as long.
os.environ.setdefault("OMP_WAIT_POLICY", "passive")
