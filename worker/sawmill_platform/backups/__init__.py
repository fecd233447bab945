"""Backups of rows and files: taking, checking and restoring; and the copy of rows from SQLite into PostgreSQL."""
