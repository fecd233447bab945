"""Preparation of a raw stack: line integrals, corrections row by row, and the alignment of views.

Others call `line_integrals.Exposure` on counts, `row_corrections` on line integrals, and `row_shifts` on stacks whose
views moved along the log; `CountsError` and `RowsError` refuse what cannot be a scan.
"""
