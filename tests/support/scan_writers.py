"""Files of other programs: each function returns one that writes such a file at a path."""

import io
from zipfile import ZIP_STORED, ZipFile

import h5py
import numpy as np
import scipy.io
import tifffile


def hdf5(members, attributes=()):
    """A dataset of each value, a group of each None, by their paths; (path, name, value) of attributes."""

    def write(path):
        with h5py.File(path, "w") as file:
            for name, value in members.items():
                if value is None:
                    file.create_group(name)
                else:
                    file[name] = value
            for member, name, value in attributes:
                file[member].attrs[name] = value

    return write


def npy(array):
    def write(path):
        with path.open("wb") as stream:
            np.save(stream, array, allow_pickle=array.dtype.hasobject)

    return write


def npz(**arrays):
    def write(path):
        with path.open("wb") as stream:
            np.savez(stream, **arrays)

    return write


def mat(*, packed=False, **variables):
    return lambda path: scipy.io.savemat(path, variables, appendmat=False, do_compression=packed)


def tiff_bytes(image, **options):
    stream = io.BytesIO()
    tifffile.imwrite(stream, image, **options)
    return stream.getvalue()


def zipped(members, method=ZIP_STORED):
    """An archive of bytes and of images, which are packed as TIFFs."""

    def write(path):
        with ZipFile(path, "w", method) as archive:
            for name, content in members.items():
                archive.writestr(name, tiff_bytes(content) if isinstance(content, np.ndarray) else content)

    return write
