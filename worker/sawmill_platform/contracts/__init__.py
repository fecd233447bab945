"""Contracts of the job service, and the base of every contract."""
