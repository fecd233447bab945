"""Files in, which may be hostile, and our own files out."""
