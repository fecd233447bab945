"""What each command of `sawmill_command.cli` does, imported by the command that does it: so the others start fast."""
