"""Drift from many scans of one scanner: drift checks pooled, and a control chart that tells a jump from a slow trend.

Method, sources and run lengths: docs/drift-chart.md.
"""
