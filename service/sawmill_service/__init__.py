"""The HTTP service: routes that decide nothing, errors, settings, the offline console."""
