"""A job service: job store, attempts, ledger, keys, files, uploads and webhooks."""
