"""TIFF files, one or more views each."""
