"""Files of our own that somebody brings back, read as a stranger's."""
