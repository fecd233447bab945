"""Pages of the system: its state and webhooks."""
