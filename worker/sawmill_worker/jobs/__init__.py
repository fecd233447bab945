"""Kinds of jobs, one module each: load, compute, store. No other package uses both science and storage."""
