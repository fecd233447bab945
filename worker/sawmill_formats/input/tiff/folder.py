"""A folder of TIFF files, one or more views each, as a scanner or a camera leaves them on a disk."""

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from functools import partial
from itertools import islice
from pathlib import Path

from sawmill_formats.errors import UnreadableScan, library_errors_translated, quoted
from sawmill_formats.input.arrays import Bounds
from sawmill_formats.input.contents import FileContents
from sawmill_formats.input.image_names import listed, natural_key
from sawmill_formats.input.parts import Part, PartKind
from sawmill_formats.input.tiff.pages import TiffPages, open_pages, opened_tiff, page_type
from sawmill_formats.input.tiff.several_files import TiffFile, is_tiff, read_files
from sawmill_formats.input.wanted import Wanted
from sawmill_vocabulary.reading_messages import ReadingMessage

MOST_FILES = 100_000


def read_folder(path: Path, selection: Wanted, bounds: Bounds, _: ExitStack) -> FileContents:
    """Read the TIFF files of a folder, each opened when its views are read. Subfolders are not read."""
    if selection.dataset is not None:
        raise UnreadableScan("contradiction", f"a folder has no named arrays; leave out {quoted(selection.dataset)!r}")
    members = [each for each in entries(path) if not (selection.apart and each.resolve() in selection.apart)]
    images = [each for each in members if _is_image(each)]
    if not images:
        raise UnreadableScan("unknown-format", "the folder holds no TIFF files; give the folder that holds the views")
    folders = [each.name for each in members if each.is_dir()]
    others = [each.name for each in members if not (_is_image(each) or each.is_dir())]
    files = [TiffFile(each.name, _size(each), partial(_opened, each)) for each in images]
    contents = read_files(
        "folder-of-tiffs", files, others, lambda name: (path / name).open("rb"), selection, bounds, rows_missing=False
    )
    subfolders = [ReadingMessage.SUBFOLDERS(folders=len(folders), names=listed(folders))] if folders else []
    return replace(contents, remarks=(*subfolders, *contents.remarks), others=tuple(images))


def folder_parts(path: Path, _: Bounds) -> Iterator[Part]:
    """Yield the files and subfolders, TIFF files with the properties of their first pages."""
    for each in entries(path):
        name = quoted(each.name)
        if each.is_dir():
            yield Part(name, PartKind.GROUP, type="folder")
        elif _is_image(each):
            yield _image_part(each, name)
        else:
            yield Part(name, PartKind.FILE, type=quoted(each.suffix.lstrip(".")) or None, stored_bytes=_size(each))


def entries(path: Path) -> list[Path]:
    """List everything in a folder, view-2 before view-10: `too-large` for more files than are read."""
    members = list(islice(path.iterdir(), MOST_FILES + 1))
    if len(members) > MOST_FILES:
        raise UnreadableScan("too-large", f"the folder holds more than {MOST_FILES} files; give one of views alone")
    return sorted(members, key=lambda each: natural_key(each.name))


def _is_image(path: Path) -> bool:
    return is_tiff(path.name) and path.is_file()


def _size(path: Path) -> int:
    """Return the size in bytes; 0 for a link to no file, which is refused later."""
    return path.stat().st_size if path.exists() else 0


@contextmanager
def _opened(path: Path, bounds: Bounds) -> Iterator[TiffPages]:
    name = repr(quoted(path.name))
    with library_errors_translated(name), open_pages(path, name, _size(path), bounds) as pages:
        yield pages


def _image_part(path: Path, name: str) -> Part:
    with library_errors_translated(repr(name)), opened_tiff(path, repr(name), _size(path)) as tiff:
        first, pages = tiff.pages[0], len(tiff.pages)
        shape = first.shape if pages == 1 else (pages, *first.shape)
        number_type, compression = page_type(first)
    return Part(name, PartKind.FILE, shape, number_type, stored_bytes=_size(path), compression=compression)
