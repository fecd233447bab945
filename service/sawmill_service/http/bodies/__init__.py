"""Bodies of requests: their digests, forms, files and JSON."""
