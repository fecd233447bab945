"""Version and packages of this code: results, the contract of the service and the command line report the version."""

VERSION = "0.2.0"

# All packages of the product, the lowest layer first.
PACKAGES = (
    "sawmill_vocabulary",
    "sawmill_platform",
    "sawmill_contracts",
    "sawmill_tomography",
    "sawmill_formats",
    "sawmill_mill",
    "sawmill_store",
    "sawmill_worker",
    "sawmill_calibration",
    "sawmill_service",
    "sawmill_command",
)
