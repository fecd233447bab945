"""Readers of uploads, which may be hostile: any supported file to one canonical scan."""
