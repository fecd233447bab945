"""Phantoms and logs as bodies of known shape, and their outlines traced from a picture.

Others use `phantom.Phantom` with discs and polygons, `built_in.BUILT_IN` by name, `tracing.trace` on a picture, and
`log_model.LogModel` for simulated logs. Densities are relative to wood or in 1/mm, lengths in mm.
"""
