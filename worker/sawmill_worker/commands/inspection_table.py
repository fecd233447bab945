"""Readable output of `sawmill inspect`."""

from collections.abc import Iterator

from rich import box
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from sawmill_contracts.inspections import FilePart, FileVerdict, InspectedReading, InspectionResult
from sawmill_formats.input.parts import PartKind

# Largest number of parts, and of other files, that are shown: about a page. `--json` prints all.
MOST_ROWS, MOST_FILES = 60, 3
WORDS = {
    FileVerdict.READY: ("can be read", "green"),
    FileVerdict.INCOMPLETE: ("more must be given", "yellow"),
    FileVerdict.REFUSED: ("refused", "red"),
}


def print_inspection(result: InspectionResult) -> None:
    """Print the parts of a file, the data that would be read, and the data that is missing."""
    word, colour = WORDS[result.verdict]
    what = f"{escape(result.file)}: {result.format or 'not readable'}, {_size(result.size_bytes)}"
    console = Console()
    console.print(f"{what}: [bold {colour}]{word}[/]", highlight=False, soft_wrap=True)
    if result.parts:
        console.print(_parts_table(result.parts[:MOST_ROWS]))
    if result.reading is not None:
        console.print(_reading_table(result.reading))
    for sentence in _sentences(result):
        console.print(f"- {sentence}", highlight=False, markup=False)


def _sentences(result: InspectionResult) -> Iterator[str]:
    left_out = result.parts_left_out + max(0, len(result.parts) - MOST_ROWS)
    if left_out:
        yield f"{left_out} more parts are not shown; --json lists {len(result.parts)}"
    if result.listing_ended is not None and (result.refusal is None or result.refusal.detail != result.listing_ended):
        yield f"the list ends there: {result.listing_ended}"
    if result.reading is not None:
        yield from result.reading.remarks
    for part in result.missing:
        yield f"{'missing' if part.needed else 'not in the file'}: {part.name} ({part.flag}): {part.why}"
    if result.refusal is not None:
        yield f"{result.refusal.code}: {result.refusal.detail}"


def _parts_table(parts: list[FilePart]) -> Table:
    table = Table(box=box.SIMPLE, padding=(0, 1, 0, 0))
    for column in ("in the file", "what"):
        table.add_column(column, overflow="fold")
    table.add_column("stored", justify="right", no_wrap=True)
    table.add_column("filters")
    names: set[str] = set()
    for part in parts:
        stored = "" if part.stored_bytes is None else _size(part.stored_bytes)
        table.add_row(*map(escape, (_indented(part.name, names), _what(part), stored, part.compression or "")))
        names.add(part.name)
    return table


def _indented(name: str, before: set[str]) -> str:
    """Indent a name below its group or struct, if the group or struct is shown."""
    group, slash, last = name.rpartition("/")
    return f"{'  ' * group.count('/')}  {slash if group.startswith('/') else ''}{last}" if group in before else name


def _what(part: FilePart) -> str:
    number = part.kind if part.count == 1 else f"{part.count} {part.kind}s, each"
    shape = "" if part.shape is None else " x ".join(map(str, part.shape)) or "one value"
    unit = "" if part.unit is None else f"in {part.unit}"
    link = part.kind == PartKind.LINK
    leads_to = "" if part.leads_to is None else f"-> {part.leads_to}" if link else f"({part.leads_to})"
    kind = number if part.count > 1 or not (shape or link) else ""
    return " ".join(filter(None, (kind, shape, part.type, unit, leads_to)))


def _reading_table(reading: InspectedReading) -> Table:
    table = Table(
        title="What would be read", title_justify="left", show_header=False, box=box.SIMPLE, padding=(0, 1, 0, 0)
    )
    shape, angles = reading.shape, reading.angles
    turn = "" if angles is None else f"{angles.first_deg:.7g} to {angles.last_deg:.7g} degrees"
    origin = "" if angles is None else f", from the file in {angles.file_unit}" if angles.from_file else ", as given"
    rows = {
        "numbers": "not known" if reading.data is None else f"{reading.data.value}, as given",
        "projections": f"{shape.views} views x {shape.rows} rows x {shape.detector} cells",
        "flat fields": "none" if reading.flats is None else str(reading.flats),
        "dark fields": "none" if reading.darks is None else str(reading.darks),
        "angles": "none" if angles is None else turn + origin,
        "detector pitch": "none" if reading.detector_pitch_mm is None else f"{reading.detector_pitch_mm:.9g} mm",
        "modules": _modules(reading),
        "row pitch": "none" if reading.row_pitch_mm is None else f"{reading.row_pitch_mm:.9g} mm",
        "other files": _some(reading.other_files),
    }
    for label, value in rows.items():
        if value is not None:
            table.add_row(label, escape(value))
    return table


def _modules(reading: InspectedReading) -> str | None:
    cells = ", ".join(str(module.first_cell) for module in reading.detector_modules)
    return f"{len(reading.detector_modules) + 1}, which meet at cell {cells}" if cells else None


def _some(files: list[str]) -> str | None:
    more = f" and {len(files) - MOST_FILES} more" if len(files) > MOST_FILES else ""
    return f"{', '.join(files[:MOST_FILES])}{more}" if files else None


def _size(number: int) -> str:
    """Format a number of bytes for people."""
    for unit, factor in (("GB", 1e9), ("MB", 1e6), ("kB", 1e3)):
        if number >= factor:
            return f"{number / factor:.3g} {unit}"
    return f"{number} B"
