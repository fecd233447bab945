"""Pages of phantoms and of the plans with them."""
