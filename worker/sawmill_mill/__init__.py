"""The rules of a mill, and their words: pure functions on small records, which need no database.

The store reads the records by its statements and writes what a rule decides.
"""
