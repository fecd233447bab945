"""Common parts of the iterative methods: the objective and its priors, the descent, and the choice of parameters."""
