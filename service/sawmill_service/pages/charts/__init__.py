"""Charts of measurements over time, drawn as SVG."""
