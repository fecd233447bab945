"""What a process is called where people read of it."""

import os
import socket


def process_name() -> str:
    """Host and process id."""
    return f"{socket.gethostname()}-{os.getpid()}"
