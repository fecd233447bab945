"""Requests that a job answers, and the rows that they refer to."""
