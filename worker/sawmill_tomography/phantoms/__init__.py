"""Phantoms and logs as bodies of known shape, and their outlines traced from a picture."""
