"""Reconstruction: from sinograms to images of a log's slices."""
