"""Backups: rows at one instant and the files that they name, in a folder that can be checked and restored.

manifest.json       what it is of, when, and the sums of rows/ and files.jsonl; manifest.sha256 is its own
files.jsonl         path, size, time and SHA-256 of every file, one JSON object a line
rows/<table>.jsonl  a row a line, of either database
data/               the files, as in the data folder

Attempts, checkpoints, arriving uploads, browsers' sessions and the machine's clock are in none.
"""
