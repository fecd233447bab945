"""`sawmill doctor`: the state of an installation in sentences, and the remedy for each problem."""
