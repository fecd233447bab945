"""The commands that need no server, from inspect and calibrate to export and worker: a module a command.

Here stand their flags and what they print. Flags come from the contracts (`commands/from_contract.py`). What a command
does stands in `sawmill_worker.commands`, which the command itself imports.
"""

COMMANDS = {
    name: f"{__name__}.{name}"
    for name in (
        "inspect",
        "calibrate",
        "report",
        "repeatability",
        "drift",
        "reconstruct",
        "simulate",
        "export",
        "worker",
        "watch",
        "compile",
        "phantom",
    )
}
