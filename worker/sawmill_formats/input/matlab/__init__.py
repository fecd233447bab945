"""MATLAB files of version 5; those of version 7.3 are HDF5."""
