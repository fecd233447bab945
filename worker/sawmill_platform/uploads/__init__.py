"""Uploads that can be resumed."""
