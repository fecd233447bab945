"""Pages of the system: its state, retention and webhooks."""
