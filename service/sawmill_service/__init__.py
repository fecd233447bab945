"""The HTTP service: routes and pages, which decide nothing."""
