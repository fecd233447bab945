"""Headers with which a volume's slices, one after the other as they are, become a file of another program.

A file is its header and then float32 (slice, x, y), little-endian: what sends it holds one slice at a time, and knows
its length before the first.
"""

import struct
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from sawmill_formats.output.volume_reader import VolumeGrid

VALUE_BYTES = 4
# Largest file that the 32-bit offsets of a TIFF reach.
_LARGEST_TIFF = 2**32
_IFD_AT = 8
_SHORT, _LONG, _ASCII, _RATIONAL = 3, 4, 2, 5


def tiff_header(grid: "VolumeGrid", unit: str) -> bytes:
    """Return the header of a TIFF stack as ImageJ writes it: a page a slice, a row of a page is +x, a column +y.

    Beyond 4 GiB there is one page, and ImageJ finds the other slices behind it by its description.
    """
    slices, rows, columns = grid.shape
    page_bytes = VALUE_BYTES * rows * columns
    described = _imagej_description(grid, unit)
    entries = 13
    ifd_bytes = 2 + 12 * entries + 4

    def laid_out(pages: int) -> tuple[int, int, int]:
        text_at = _IFD_AT + pages * ifd_bytes
        resolution_at = text_at + len(described)
        return text_at, resolution_at, -(-(resolution_at + 8) // 16) * 16

    pages = slices if laid_out(slices)[2] + slices * page_bytes < _LARGEST_TIFF else 1
    text_at, resolution_at, data_at = laid_out(pages)

    def page(number: int) -> bytes:
        tags = (
            (256, _LONG, 1, columns),
            (257, _LONG, 1, rows),
            (258, _SHORT, 1, 8 * VALUE_BYTES),
            (259, _SHORT, 1, 1),  # not packed
            (262, _SHORT, 1, 1),  # 0 is black
            (270, _ASCII, len(described), text_at),
            (273, _LONG, 1, data_at + number * page_bytes),
            (278, _LONG, 1, rows),
            (279, _LONG, 1, page_bytes),
            (282, _RATIONAL, 1, resolution_at),
            (283, _RATIONAL, 1, resolution_at),
            (296, _SHORT, 1, 1),  # of the unit that the description names
            (339, _SHORT, 1, 3),  # floating point
        )
        following = _IFD_AT + (number + 1) * ifd_bytes if number + 1 < pages else 0
        packed = b"".join(struct.pack("<HHLL", *tag) for tag in tags)
        return struct.pack("<H", entries) + packed + struct.pack("<L", following)

    per_mm = struct.pack("<LL", round(1e9 / max(1.0, grid.pixel_mm)), round(1e9 * min(1.0, grid.pixel_mm)))
    head = struct.pack("<2sHL", b"II", 42, _IFD_AT) + b"".join(map(page, range(pages))) + described + per_mm
    return head.ljust(data_at, b"\0")


def _imagej_description(grid: "VolumeGrid", unit: str) -> bytes:
    """Return the text by which ImageJ knows slices and millimetres; a pixel's number counts its centre."""
    x_mm, y_mm = grid.first_pixel_mm
    lines = {
        "ImageJ": "1.54f",
        "images": grid.shape[0],
        "slices": grid.shape[0],
        "unit": "mm",
        "xorigin": -y_mm / grid.pixel_mm,
        "yorigin": -x_mm / grid.pixel_mm,
        "vunit": unit,
        "loop": "false",
    }
    if grid.spacing_mm is not None:
        lines |= {"spacing": grid.spacing_mm, "zorigin": -(grid.first_height_mm or 0.0) / grid.spacing_mm}
    return "".join(f"{name}={value}\n" for name, value in lines.items()).encode("ascii") + b"\0"


def nrrd_header(grid: "VolumeGrid", unit: str) -> bytes:
    """Return the header of an NRRD file with each value at its x, y, z in mm; slices without spacing lie 1 apart."""
    slices, rows, columns = grid.shape
    pixel, spacing = grid.pixel_mm, 1.0 if grid.spacing_mm is None else grid.spacing_mm
    x_mm, y_mm = grid.first_pixel_mm
    along = "mm" if grid.spacing_mm is not None else ""
    lines = (
        "NRRD0004",
        "type: float",
        "dimension: 3",
        "space: left-posterior-superior",
        f"sizes: {columns} {rows} {slices}",
        f"space directions: (0,{pixel!r},0) ({pixel!r},0,0) (0,0,{spacing!r})",
        f"space origin: ({x_mm!r},{y_mm!r},{grid.first_height_mm or 0.0!r})",
        f'space units: "mm" "mm" "{along}"',
        "kinds: domain domain domain",
        f"sample units: {unit}",
        "endian: little",
        "encoding: raw",
    )
    return "\n".join(lines).encode("ascii") + b"\n\n"
