"""Arrays to PNG: a leaf room that imports nothing else of ours."""
