"""Projection: analytic for bodies of known shape, discrete with its adjoint for images."""
