"""/v1/reconstructions: slices as arrays and small pictures, for viewers and programs; /v1/color-maps.

The first request imports the modules that read and draw, as in `routes/reconstructions.py`.
"""
# ruff: noqa: PLC0415 - for that reason

import math
from collections.abc import Callable, Iterator, Mapping
from typing import TYPE_CHECKING, Annotated, Any

from fastapi import Path, Query, Request, Response
from pydantic import Field

from sawmill_contracts.choices import Axis
from sawmill_contracts.reconstructions import ReconstructionResult
from sawmill_formats.output.volume_exports import nrrd_header, tiff_header
from sawmill_platform.contracts.base import Identifier
from sawmill_platform.contracts.given import Given
from sawmill_platform.contracts.keys import Scope
from sawmill_service.dependencies import TheStore
from sawmill_service.drawing import BYTES_PER_VALUE, check_slice, result_of, volume_thumbnail
from sawmill_service.http.document.described_answers import NAMED, OF_RESULT, drawn, refuses, stored
from sawmill_service.http.document.openapi_document import trying
from sawmill_service.http.responses.answers import Jpeg, Npy, Nrrd, Png, Tiff, unchanging
from sawmill_service.http.responses.drawn import exported, kept_picture, picture
from sawmill_service.http.route_rules import Router
from sawmill_service.routes.reconstructions import WindowQuery, window_to_draw
from sawmill_store.calibrations import Reconstructions
from sawmill_vocabulary import ColorMap

if TYPE_CHECKING:
    from sawmill_formats.output.volume_reader import VolumeGrid

_FLOAT32_BYTES = 4
# A list of three, not a tuple: some generators of clients ignore `prefixItems`.
Color = Annotated[list[Annotated[int, Field(ge=0, le=255)]], Field(min_length=3, max_length=3)]

router = Router(tags=["reconstructions"], reading=Scope.READ)
folder = "/v1/reconstructions/{reconstruction_id}"

_HEADERS: dict[str, Any] = {
    "X-Pixel-Mm": {"description": "Distance between the array's pixels.", "schema": {"type": "number"}},
    "X-First-Pixel-Mm": {
        "description": "x and y of the centre of pixel [0, 0], with a comma between.",
        "schema": {"type": "string"},
    },
    "X-Height-Mm": {
        "description": "Position of the slice along the log; absent where slices have no spacing.",
        "schema": {"type": "number"},
    },
    "X-Unit": {"description": "Unit of the values.", "schema": {"type": "string"}},
}


class ArrayQuery(Given):
    """Largest size of the array to send."""

    max_size: Annotated[int, Field(ge=16, le=4096)] | None = Field(
        None,
        description="Most pixels along a side: a larger slice is averaged over the fewest whole pixels, 2 x 2 or 3 "
        "x 3 and so on, with which it fits. Null: full size.",
        examples=[512],
    )


class JpegQuery(WindowQuery, ArrayQuery):
    """Window of the values to draw, and the largest size of the picture to send."""


class SideArrayQuery(Given):
    """Direction of a side view of the log, and the largest size of the array to send."""

    max_size: Annotated[int, Field(ge=16, le=4096)] | None = Field(
        None,
        description="Most values along each axis: a longer axis is reduced to the largest of 2, 3 or more "
        "neighbours, the fewest with which it fits. Null: one value for each slice and pixel.",
        examples=[512],
    )
    along: Axis = Field("x", description="Axis along which the log is seen; the other one is the array's second.")


@router.get(
    f"{folder}/slices/{{index}}.npy",
    response_class=Npy,
    summary="Get a slice as an array",
    responses=drawn(*OF_RESULT, "slice-not-found", headers=_HEADERS),
    openapi_extra=trying(index=0, max_size=512),
)
def get_slice_array(
    reconstruction_id: Identifier,
    index: Annotated[int, Path(ge=0, description="Number of the slice, from 0.", examples=[0])],
    query: Annotated[ArrayQuery, Query()],
    request: Request,
    store: TheStore,
) -> Response:
    """Return float32 (x, y) as an NPY file: a row is +x, a column +y, as in the pictures."""
    result = result_of(store.reconstructions, reconstruction_id)
    check_slice(result, index)
    factor = _averaged_pixels(result, query)

    def read() -> tuple[bytes, Mapping[str, str]]:
        from sawmill_calibration.pictures.images import averaged, npy
        from sawmill_formats.output import volume_reader

        image = volume_reader.volume_slice(store.reconstructions.files.volume(reconstruction_id), result.shape, index)
        # Shift to the middle of the first block of pixels.
        shift_mm = 0.5 * (factor - 1) * image.pixel_mm
        headers = {
            "X-Pixel-Mm": repr(factor * image.pixel_mm),
            "X-First-Pixel-Mm": ",".join(repr(place + shift_mm) for place in image.first_pixel_mm),
            "X-Unit": image.unit,
        }
        if image.height_mm is not None:
            headers["X-Height-Mm"] = repr(image.height_mm)
        return npy(averaged(image.data, factor)), headers

    name = f"{store.reconstructions.file_name(reconstruction_id)}, slice {index}.npy"
    made_of, size_bytes = (reconstruction_id, index, factor, "npy"), _slice_bytes(result)
    return unchanging(picture(request, made_of, read, size_bytes=size_bytes, answer=Npy, save_as=name))


@router.get(
    f"{folder}/slices/{{index}}.jpg",
    response_class=Jpeg,
    summary="Draw a slice in few bytes",
    responses=drawn(*OF_RESULT, "slice-not-found", "empty-window"),
    openapi_extra=trying(index=0, max_size=512),
)
def get_slice_jpeg(
    reconstruction_id: Identifier,
    index: Annotated[int, Path(ge=0, description="Number of the slice, from 0.", examples=[0])],
    query: Annotated[JpegQuery, Query()],
    request: Request,
    store: TheStore,
) -> Response:
    """Draw 8 bits a colour, nothing around the slice, a row is +x and a column +y: for a preview, not for measuring."""
    result = result_of(store.reconstructions, reconstruction_id)
    check_slice(result, index)
    window = window_to_draw(query, result.value_range)

    def draw() -> bytes:
        from sawmill_calibration.pictures.images import averaged, jpeg
        from sawmill_formats.output import volume_reader

        image = volume_reader.volume_slice(store.reconstructions.files.volume(reconstruction_id), result.shape, index)
        return jpeg(averaged(image.data, _averaged_pixels(result, query)), window, query.color_map)

    made_of = (reconstruction_id, index, query)
    return unchanging(picture(request, made_of, draw, size_bytes=_slice_bytes(result), answer=Jpeg))


def _averaged_pixels(result: ReconstructionResult, query: ArrayQuery) -> int:
    """Return the side of the blocks of pixels that are averaged so that a slice fits into `max_size`."""
    side = max(result.shape[1:])
    return -(-side // (query.max_size or side))


def _slice_bytes(result: ReconstructionResult) -> int:
    """Return the peak of the memory in which a slice is read and made into what is sent."""
    return BYTES_PER_VALUE * math.prod(result.shape[1:])


@router.get(
    f"{folder}/side.npy",
    response_class=Npy,
    summary="Get the side view as an array",
    responses=drawn(*OF_RESULT, "no-side-view", headers={"X-Unit": _HEADERS["X-Unit"]}),
    openapi_extra=trying(along="x"),
)
def get_side_array(
    reconstruction_id: Identifier, query: Annotated[SideArrayQuery, Query()], request: Request, store: TheStore
) -> Response:
    """Return float32 (slice, y) or (slice, x): the densest value behind each point of the log's side."""
    shape = result_of(store.reconstructions, reconstruction_id).shape
    slices, *size = shape

    def read() -> tuple[bytes, Mapping[str, str]]:
        from sawmill_calibration.pictures.images import npy
        from sawmill_calibration.pictures.log_pictures import densest_of
        from sawmill_formats.output import volume_reader

        view = volume_reader.side_view(store.reconstructions.files.volume(reconstruction_id), shape, query.along)
        most = (query.max_size or slices, query.max_size or max(size))
        return npy(densest_of(view.data, most)), {"X-Unit": view.unit}

    name = f"{store.reconstructions.file_name(reconstruction_id)}, side along {query.along}.npy"
    size_bytes = BYTES_PER_VALUE * slices * max(size)
    made_of = (reconstruction_id, "side", query, "npy")
    return unchanging(picture(request, made_of, read, size_bytes=size_bytes, answer=Npy, save_as=name))


@router.get(
    f"{folder}/volume.tif",
    response_class=Tiff,
    summary="Get the volume as a TIFF stack",
    responses=NAMED | refuses(*OF_RESULT),
)
def get_volume_tiff(reconstruction_id: Identifier, request: Request, store: TheStore) -> Response:
    """Return float32 pages for ImageJ, one a slice, with pixels and spacing in mm; a row of a page is +x, a column +y.

    The file is written while it is sent: a part of it cannot be requested.
    """
    return _export(request, store.reconstructions, reconstruction_id, "tif", Tiff, tiff_header)


@router.get(
    f"{folder}/volume.nrrd",
    response_class=Nrrd,
    summary="Get the volume as NRRD",
    responses=NAMED | refuses(*OF_RESULT),
)
def get_volume_nrrd(reconstruction_id: Identifier, request: Request, store: TheStore) -> Response:
    """Return float32 for 3D Slicer, the axes y, x, slice from the fastest on, with spacings and the origin in mm.

    The file is written while it is sent: a part of it cannot be requested.
    """
    return _export(request, store.reconstructions, reconstruction_id, "nrrd", Nrrd, nrrd_header)


def _export(
    request: Request,
    reconstructions: Reconstructions,
    reconstruction_id: str,
    suffix: str,
    answer: type[Response],
    header_of: Callable[["VolumeGrid", str], bytes],
) -> Response:
    """Return the volume as a file of another program."""
    from sawmill_formats.output import volume_reader

    result = result_of(reconstructions, reconstruction_id)
    path, shape = reconstructions.files.volume(reconstruction_id), result.shape
    header = header_of(volume_reader.volume_grid(path, shape), result.unit)

    def pieces() -> Iterator[bytes | memoryview]:
        yield header
        for image in volume_reader.volume_slices(path, shape, range(shape[0])):
            yield image.data.astype("<f4", copy=False).reshape(-1).data.cast("B")

    length = len(header) + _FLOAT32_BYTES * math.prod(shape)
    name = f"{reconstructions.file_name(reconstruction_id)}.{suffix}"
    return exported(request, answer, length, _slice_bytes(result) + len(header), pieces(), save_as=name)


@router.get(
    f"{folder}/thumbnail.png",
    response_class=Png,
    summary="Get a reconstruction as a small picture",
    responses=stored(*OF_RESULT),
)
def get_reconstruction_thumbnail(reconstruction_id: Identifier, request: Request, store: TheStore) -> Response:
    """Draw the middle slice, 160 pixels a side, for lists."""
    result = result_of(store.reconstructions, reconstruction_id)
    return kept_picture(
        request, _slice_bytes(result), lambda: volume_thumbnail(store.reconstructions.files, reconstruction_id, result)
    )


@router.get("/v1/color-maps", summary="Get the colour maps")
def list_color_maps() -> dict[ColorMap, list[Color]]:
    """List each map's 256 colours (red, green, blue of 255), from a window's low end to its high end."""
    from sawmill_calibration.pictures.pages import color_table

    return {name: color_table(name).tolist() for name in ColorMap}
