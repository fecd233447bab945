"""A progress bar on standard error."""

from collections.abc import Iterator
from contextlib import contextmanager
from datetime import timedelta

from rich.console import Console
from rich.progress import BarColumn, Task, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.progress import Progress as Bar
from rich.text import Text

from sawmill_vocabulary import Progress, ProgressCallback


class _TimeLeft(TimeRemainingColumn):
    """Remaining time as the work reports it; by the pace of the bar if the work reports none."""

    def render(self, task: Task) -> Text:
        seconds_left = task.fields["seconds_left"]
        if seconds_left is None:
            return super().render(task)
        return Text(str(timedelta(seconds=round(seconds_left))), style="progress.remaining")


@contextmanager
def progress_bar(what: str) -> Iterator[ProgressCallback]:
    """Show a bar of the work `what` until the block ends; yield the callback that moves the bar."""
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.percentage:3.0f} %"),
        TimeElapsedColumn(),
        _TimeLeft(),
    )
    with Bar(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(what, total=1.0, seconds_left=None)

        def show(progress: Progress) -> None:
            best = "" if progress.best_value is None else f", best {progress.best_value:.5g}"
            generation = "" if progress.generation is None else f" generation {progress.generation}{best}"
            description = f"{what}: {progress.stage}{generation}"
            bar.update(task, completed=progress.fraction, description=description, seconds_left=progress.seconds_left)

        yield show
