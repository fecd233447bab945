"""Files in and out: any upload to one canonical scan, and results to HDF5."""
