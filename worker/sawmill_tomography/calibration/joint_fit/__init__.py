"""The joint fit: the geometry and every effect that a scan shows, by generalised least squares."""
