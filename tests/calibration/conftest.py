"""The small scanner that use cases are tried on."""

from small_scanner import calibration, constants, scanner, sinogram, spec, theta, turn  # noqa: F401 - fixtures
