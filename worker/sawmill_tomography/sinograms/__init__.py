"""Sinograms: their air, noise, faulty cells, hardening and missing rays.

Others use `air.find_air`, `noise`, `hardening`, `present_rows` of a stack, `screening` of views and cells, and
`masked_rays`. All take line integrals (views, detector).
"""
