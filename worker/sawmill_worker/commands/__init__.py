"""Work of the commands in `sawmill_command.cli`; a command imports only its own module, so that all start fast."""
