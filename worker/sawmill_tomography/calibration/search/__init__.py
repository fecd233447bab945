"""The search: initial guesses of the geometry, and the first fits from them."""
