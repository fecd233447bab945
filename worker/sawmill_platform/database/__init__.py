"""Transactions, tables and pages of rows, on SQLite and PostgreSQL alike."""
