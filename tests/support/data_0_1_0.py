"""A data folder of version 0.1.0 with its examples, made by that version's code (`make_data_0_1_0.py`, ff825056)."""

from pathlib import Path

ARCHIVE = Path(__file__).with_name("data_0_1_0.tar.xz")
