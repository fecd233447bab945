"""Commands that need no server, from inspect and calibrate to export and worker: one module per command.

The modules hold flags and output. Flags come from the contracts (`commands/from_contract.py`). A command calls
`sawmill_calibration`, as a job does, and imports it when it runs.
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
        "pack",
        "export",
        "worker",
        "compile",
        "phantom",
    )
} | {
    "budget": f"{__name__}.report",
    "image-quality": f"{__name__}.reconstruct",
    "calibrate-pairs": f"{__name__}.calibrate_pairs",
    "locate-marks": f"{__name__}.calibrate_pairs",
}
