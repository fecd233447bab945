"""`sawmill compile`."""
# ruff: noqa: PLC0415 - imports inside the command: its help needs none

import typer

from sawmill_worker.commands.terminal import Command, answering, showing_progress

app = typer.Typer()


@app.command(name="compile", cls=Command)
def compile_() -> None:
    """Compile the numerical kernels and the byte code now: once on a machine, else the first job waits for it."""
    with answering(), showing_progress("compiling kernels, once on this machine") as on_progress:
        from sawmill_worker.commands.compile import bytecode_folders, compile_bytecode, compile_kernels

        compile_bytecode(bytecode_folders())
        compile_kernels(on_progress)
