"""The product under faults (`benchmarks/inject_faults.py`)."""
