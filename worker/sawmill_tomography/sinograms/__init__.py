"""Sinograms: their air, noise, faulty cells, scatter, hardening and missing rays.

Others use `air.find_air`, `noise`, `scattered_radiation` with its `straightened`, `present_rows` of a stack,
`screening` of views and cells, and `masked_rays`. All take line integrals (views, detector).
"""
