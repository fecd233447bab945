"""HDF5 files of other programs, read without anything outside the file."""
