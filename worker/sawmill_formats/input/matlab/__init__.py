"""MATLAB files of version 5; files of version 7.3 are HDF5."""
