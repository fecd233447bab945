"""Reconstruction: from sinograms to images of a log's slices.

Others call `fbp.fbp`, and all methods by name through `choosing.METHODS`; all return an `estimate.Estimate`.
`choosing.recommend` names a method, `cost` predicts seconds, `metal.MetalSearch` finds nails before any of them.
Lines are (slices, views, detector), images (slices, size, size) in the sinogram's unit per mm.
"""
