"""Rows and files: the job store, the resources it works on, and the folders that hold their arrays."""
