"""Drift from many scans of one scanner: drift checks pooled, and a control chart that separates jumps from slow trends.

Method, sources and run lengths: docs/understand/drift.md.
"""
