"""Removal of rows that rules of retention reach, with their files, and of files that no row names."""
