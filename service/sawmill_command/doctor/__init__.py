"""`sawmill doctor`: how an installation is, a sentence each, and what to do about what is wrong."""
