"""What the iterative methods share: the objective, its descent, and what is chosen by holding out."""
