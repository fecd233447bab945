"""Measurements of drift checks, and the charts that follow them."""
