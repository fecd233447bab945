"""Scans: inspection, preparation, selection and simulation."""
