"""The small scanner that use cases are tried on."""

from small_scanner import calibration, constants, scanner, sinogram, theta, turn  # noqa: F401 - fixtures
