"""What each command of `worker.cli` does, imported by the command that does it: so the others start fast."""
