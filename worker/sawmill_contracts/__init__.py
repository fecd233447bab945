"""Contracts of a mill: what can be asked and is answered about scanners, scans and calibrations.

Every boundary name carries its unit. Unknown fields are refused.
"""
