"""HTTP: limits, bodies, responses, errors and the public document."""
