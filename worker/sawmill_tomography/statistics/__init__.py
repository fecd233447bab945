"""Statistics that several rooms of the science need."""
