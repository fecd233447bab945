"""Statistics for several packages of the science."""
