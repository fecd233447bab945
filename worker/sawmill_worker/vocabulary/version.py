"""The version of this code: results, the contract of the service and the command line report it."""

VERSION = "0.2.0"
