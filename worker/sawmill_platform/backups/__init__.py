"""Backups: rows at one instant and the files that they name, in a folder that can be checked and restored.

manifest.json       source and time of the backup, sums of rows/ and files.jsonl; its own sum is manifest.sha256
files.jsonl         path, size, time and SHA-256 of every file, one JSON object in a line
rows/<table>.jsonl  one row in a line, of either database
data/               the files, as in the data folder

A backup has no attempts, checkpoints, unfinished uploads, browser sessions and no clock of the machine.
"""
