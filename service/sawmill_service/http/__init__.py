"""HTTP alone: limits, conditions, bodies, errors, and the public document."""
