"""Projection: analytic for bodies of known shape, discrete with its adjoint for images.

Others use `projector.Projector` of a geometry and a grid, `analytic.project` of a phantom, and `simulate` for scans.
Sinograms are (views, detector), images (x, y); kernels are called through these alone.
"""
