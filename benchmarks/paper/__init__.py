"""The experiments of arXiv 2206.14444, run again with the product."""
