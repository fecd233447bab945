"""A job service: job store, attempts, ledger, keys, files, uploads, webhooks and backups."""
