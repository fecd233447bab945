"""Commands that need no server, from inspect and calibrate to export and worker: one module per command.

The modules hold flags and output. Flags come from the contracts (`commands/from_contract.py`). A command calls
`sawmill_calibration`, as a job does, and imports it when it runs.
"""
