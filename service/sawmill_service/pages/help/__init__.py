"""The documents of the product as pages at /help, with a search."""
