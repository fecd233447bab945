"""Pictures of contracts and arrays as PNG and SVG."""
