"""Writing of reconstructed volumes: HDF5 as NXtomoproc and as VTKHDF (docs.vtk.org, VTKHDF file format, ImageData).

Packing of whole chunks as the HDF5 library's filters would, in half their time and outside the library's lock. The
stream is plain deflate, so every reader unpacks it; only the search for repeats is left out, which finds nothing in
the noise of a reconstruction: runs and the frequencies of bytes are what there is to save.
"""

import struct
import zlib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from sawmill_formats import nexus as layout
from sawmill_formats.hdf5 import whole_hdf5
from sawmill_formats.nexus import PACKED, new_entry, new_group, write_mapping, write_process, write_scalar

# Number of slices in a chunk of the side views: about as many as are written at a time.
SIDE_VIEW_ROWS = 64


@dataclass(frozen=True, eq=False)
class PackedSlices:
    """Slices as they are stored."""

    chunks: tuple[bytes, ...]  # one chunk for each slice
    along_x: NDArray[np.float32]  # (slices, y) float32: maximum of each slice along x, and along y
    along_y: NDArray[np.float32]  # (slices, x) float32

    @classmethod
    def of(cls, slices: NDArray[np.float32]) -> "PackedSlices":
        """Pack slices (slices, x, y)."""
        single = slices.astype(np.float32, copy=False)
        return cls(tuple(map(pack, single)), single.max(axis=1), single.max(axis=2))

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return the packed slices as arrays of numbers."""
        chunks = {f"chunk_{n}": np.frombuffer(chunk, np.uint8) for n, chunk in enumerate(self.chunks)}
        return {"along_x": self.along_x, "along_y": self.along_y, **chunks}

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray[Any]]) -> "PackedSlices":
        """Restore packed slices from `arrays`; other arrays in the mapping are ignored."""
        along_x, along_y = arrays["along_x"], arrays["along_y"]
        return cls(tuple(arrays[f"chunk_{n}"].tobytes() for n in range(len(along_x))), along_x, along_y)


class NewVolume:
    """A volume that is being written, from any thread."""

    def __init__(self, file: h5py.File) -> None:
        self._file, self._volume = file, file[layout.PLOT][layout.VALUES]
        self._along_x, self._along_y = _new_side_views(file)

    def write(self, first: int, slices: NDArray[np.float32]) -> None:
        """Write slices (slices, x, y), and their side views."""
        self.write_packed(first, PackedSlices.of(slices))

    def write_packed(self, first: int, slices: PackedSlices) -> None:
        """Write packed slices as `write` does."""
        for n, chunk in enumerate(slices.chunks, first):
            write_chunk(self._volume, n, chunk)
        written = np.s_[first : first + len(slices.chunks)]
        self._along_x[written], self._along_y[written] = slices.along_x, slices.along_y

    def note_method(self, report: Mapping[str, Any]) -> None:
        """Write what the method did; JSON-able, the units in the names."""
        write_mapping(self._file[layout.RECONSTRUCTION], "method", report)

    def note_alpha_curve(self, columns: Mapping[str, NDArray[np.float64]]) -> None:
        """Write the curve of a rule for Tikhonov's alpha, a column each."""
        group = new_group(self._file, layout.ALPHA_CURVE, "NXcollection")
        for name, values in columns.items():
            group[name] = values


@contextmanager
def new_reconstruction(
    path: Path,
    shape: tuple[int, int, int],
    *,
    pixel_mm: float,
    row_pitch_mm: float | None,
    unit: str,
    geometry: Mapping[str, Any],
    parameters: Mapping[str, Any],
    software_version: str,
    input_sha256: str,
    centre_mm: tuple[float, float] = (0.0, 0.0),
    first_slice_mm: float = 0.0,
) -> Iterator[NewVolume]:
    """Yield the writer of slices of a volume in /entry/reconstruction/data, laid out as NXtomoproc and as VTKHDF.

    The volume is stored once: in /entry/data, where NXtomoproc expects it; /VTKHDF has a virtual dataset of it.
    The file is there when the block has ended without an error, and not before.

    Parameters
    ----------
    shape : (slice, x, y)
        Shape of the whole volume.
    pixel_mm : float
        Side of a pixel.
    row_pitch_mm : float or None
        Distance between slices; None where they have no spacing: then the slice axis counts them.
    unit : str
        Unit of the volume's values, as in `1/mm`.
    geometry, parameters : mapping
        JSON-able, the units in the names.
    software_version, input_sha256 : str
        Version of the program that made the volume, and checksum of the scan.
    centre_mm : (x, y)
        Middle of the slices, the rotation centre at (0, 0).
    first_slice_mm : float
        Position of the first slice along the log.

    Raises
    ------
    OSError
        When the file cannot be written.
    """
    with whole_hdf5(path) as file:
        entry = new_entry(file, layout.DEFINITION)
        entry["title"] = "Attenuation of a log, in slices {} x {} x {}".format(*shape)
        # Pixel centres at -half + (i + 1/2) h: docs/look-up/conventions.md#axes.
        x_mm, y_mm = (
            middle + (np.arange(size, dtype=np.float64) + 0.5 - size / 2) * pixel_mm
            for size, middle in zip(shape[1:], centre_mm, strict=True)
        )
        slices = np.arange(shape[0], dtype=np.float64)
        along = slices if row_pitch_mm is None else first_slice_mm + slices * row_pitch_mm
        volume = _new_volume(entry, unit, along, x_mm, y_mm, spaced=row_pitch_mm is not None)
        describe_image(volume, (along, x_mm, y_mm), (row_pitch_mm or 1.0, pixel_mm, pixel_mm))
        # NXtomoproc requires a source and a sample.
        source = new_group(new_group(entry, "instrument", "NXinstrument"), "source", "NXsource")
        source["type"], source["probe"] = "Fixed Tube X-ray", "x-ray"
        source["name"] = "X-ray tube of the sawmill's scanner"
        new_group(entry, "sample", "NXsample")["name"] = "log"
        process = write_process(file, layout.RECONSTRUCTION, software_version, input_sha256)
        # The scan's file had a name at its origin; here it is known by its checksum.
        write_mapping(process, "parameters", {**parameters, "raw_file": f"sha256:{input_sha256}"})
        process["parameters"].attrs["NX_class"] = "NXparameters"
        for dataset in (volume, *(file[layout.PLOT][axis] for axis in file[layout.PLOT].attrs["axes"])):
            file[layout.RECONSTRUCTION][dataset.name.rpartition("/")[2]] = dataset  # a hard link
        file[layout.PROCESS] = process
        write_mapping(entry, "geometry", geometry)
        yield NewVolume(file)


def _new_volume(
    entry: h5py.Group,
    unit: str,
    along: NDArray[np.float64],
    x_mm: NDArray[np.float64],
    y_mm: NDArray[np.float64],
    *,
    spaced: bool,
) -> h5py.Dataset:
    data = new_group(entry.file, layout.PLOT, "NXdata")
    entry.attrs["default"] = "data"
    data.attrs["signal"] = "data"
    data.attrs["axes"] = ["z" if spaced else "slice", "x", "y"]
    data["title"] = entry["title"]
    shape = len(along), len(x_mm), len(y_mm)
    volume: h5py.Dataset = data.create_dataset(
        layout.VALUES, shape, np.float32, chunks=(1, *shape[1:]), **PACKED, fletcher32=True
    )
    volume.attrs["units"] = unit
    volume.attrs["long_name"] = f"attenuation ({unit})"
    # NXtomoproc requires texts on how values became numbers: they are stored as they are.
    volume.attrs["transform"], volume.attrs["offset"], volume.attrs["scaling"] = "none", "0", "1"
    write_scalar(data, "x", x_mm, "mm")
    write_scalar(data, "y", y_mm, "mm")
    if spaced:
        write_scalar(data, "z", along, "mm")
        data["z"].attrs["long_name"] = "z, along the log (mm)"
    else:
        write_scalar(data, "slice", along, "1")
        data["slice"].attrs["long_name"] = "slice"
        # NXtomoproc requires a z, in any unit.
        data["z"] = data["slice"]
    return volume


def _new_side_views(file: h5py.File) -> list[h5py.Dataset]:
    """Make the datasets of each slice's maximum along x, (slice, y), and along y, (slice, x), still to be written."""
    volume = file[layout.PLOT]
    slice_axis, x, y = volume.attrs["axes"]
    new_group(file, layout.SIDE_VIEWS, "NXcollection")
    datasets = []
    for along, across in ((x, y), (y, x)):
        view = new_group(file, layout.side_view(along), "NXdata")
        view.attrs["signal"] = "data"
        view.attrs["axes"] = [slice_axis, across]
        view["title"] = f"Densest along {along}"
        for axis in (slice_axis, across):
            view[axis] = volume[axis]
        shape = len(volume[slice_axis]), len(volume[across])
        chunks = min(shape[0], SIDE_VIEW_ROWS), shape[1]
        data = view.create_dataset("data", shape, np.float32, chunks=chunks, **PACKED, fletcher32=True)
        for name in ("units", "long_name"):
            data.attrs[name] = volume["data"].attrs[name]
        datasets.append(data)
    return datasets


_GROUP, _POINTS = "VTKHDF", "VTKHDF/PointData"
# VTK counts along an array's last axis first, and that is y: its (i, j, k) run along y, x and z. Volumes are drawn only
# where these three are right-handed, so the slices are in reverse order.
_ALONG_Y_X_MINUS_Z = ((0.0, 1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, -1.0))


def describe_image(volume: h5py.Dataset, axes_mm: Sequence[NDArray[np.float64]], spacing_mm: Sequence[float]) -> None:
    """Describe the positions of a volume's values (z, x, y) to VTK: each is a point in the middle of its pixel.

    `axes_mm` (z, x, y): centres of the pixels along each axis. `spacing_mm` (z, x, y): distances between the centres.
    """
    z_mm, x_mm, y_mm = axes_mm
    group = volume.file.create_group(_GROUP)
    # The oldest version that has images, so that every reader accepts it.
    group.attrs["Version"] = np.array([1, 0])
    # Readers require texts of fixed length.
    group.attrs["Type"] = np.bytes_("ImageData")
    group.attrs["WholeExtent"] = np.ravel([(0, length - 1) for length in reversed(volume.shape)])
    group.attrs["Origin"] = np.array([x_mm[0], y_mm[0], z_mm[-1]])
    group.attrs["Spacing"] = np.array(spacing_mm[::-1])
    group.attrs["Direction"] = np.ravel(_ALONG_Y_X_MINUS_Z)
    volume.file.create_group(_POINTS)
    # The values (z, x, y) of the pixels; nothing is copied.
    source = h5py.VirtualSource(".", volume.name, volume.shape)
    if len(volume) == 1:
        # VTK reads an image of one slice from two axes.
        layout = h5py.VirtualLayout(volume.shape[1:], volume.dtype)
        layout[...] = source[0]
    else:
        layout = h5py.VirtualLayout(volume.shape, volume.dtype)
        for n in range(len(volume)):
            layout[len(volume) - 1 - n] = source[n]
    volume.file[_POINTS].create_virtual_dataset("attenuation", layout).attrs["Attribute"] = np.bytes_("Scalars")


# Words a block of the checksum, whose sums are computed from the blocks' sums.
WORDS_AT_ONCE = 4096


def pack(chunk: NDArray[Any]) -> bytes:
    """Pack a chunk of a dataset made with shuffle, gzip and fletcher32, as `write_direct_chunk` takes it."""
    values = np.ascontiguousarray(chunk)
    planes = np.ascontiguousarray(values.view(np.uint8).reshape(-1, values.itemsize).T)
    deflate = zlib.compressobj(1, zlib.DEFLATED, zlib.MAX_WBITS, zlib.DEF_MEM_LEVEL, zlib.Z_RLE)
    packed = deflate.compress(planes.data) + deflate.flush()
    return packed + struct.pack("<I", fletcher32(packed))


def write_chunk(dataset: h5py.Dataset, index: int, packed: bytes) -> None:
    """Write a packed chunk at an index of the first axis, which spans the others."""
    dataset.id.write_direct_chunk((index, *(0 for _ in dataset.shape[1:])), packed)


def fletcher32(data: bytes) -> int:
    """Compute HDF5's checksum: two sums of big-endian 16-bit words modulo 65535, an odd byte padded with zero."""
    odd = len(data) % 2
    # Zeros in front add nothing to either sum, as the second sum counts places from the end.
    words = np.frombuffer(b"\0" * (-(len(data) + odd) % (2 * WORDS_AT_ONCE)) + data + b"\0" * odd, ">u2")
    if not words.any():
        return 0
    places = np.arange(WORDS_AT_ONCE, 0, -1.0)
    # Exact in double precision: both are less than 2^41.
    blocks = words.reshape(-1, WORDS_AT_ONCE).astype(np.float64) @ np.stack([np.ones_like(places), places], axis=1)
    sums, weighted = blocks.astype(np.uint64).T
    behind = np.arange(len(sums) - 1, -1, -1, dtype=np.uint64) * np.uint64(WORDS_AT_ONCE) % np.uint64(65535)
    # A sum that is a multiple of 65535 is written as 65535, not as 0: the library folds, it does not divide.
    first, second = ((int(total) - 1) % 65535 + 1 for total in (sums.sum(), weighted.sum() + sums @ behind))
    return second << 16 | first
