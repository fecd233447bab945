"""The layout of our own files, their writers and readers, and the readers of uploads."""
