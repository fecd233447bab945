"""Name of a process for people."""

import os
import socket


def process_name() -> str:
    """Return the host and the process id."""
    return f"{socket.gethostname()}-{os.getpid()}"
