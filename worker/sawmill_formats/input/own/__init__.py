"""Files of our own that a client sends, read as untrusted files."""
