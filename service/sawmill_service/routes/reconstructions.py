"""/v1/reconstructions: pictures and the volume, in addition to the routes of every asked kind.

The first picture imports the modules that draw: a service that draws none does not hold NumPy, h5py and Pillow.
"""
# ruff: noqa: PLC0415 - for that reason

import math
from collections.abc import Sequence
from enum import IntEnum, StrEnum
from typing import Annotated, Self

from fastapi import Path, Query, Request, Response
from pydantic import AfterValidator, Field, model_validator

from sawmill_contracts import kinds
from sawmill_contracts import reconstructions as contract
from sawmill_contracts.choices import Axis
from sawmill_contracts.reconstructions import MarkRequest, Reconstruction, ReconstructionName
from sawmill_contracts.row_ranges import STEPPED_ROWS, parse_span
from sawmill_platform.contracts.base import LARGEST_NUMBER, Identifier
from sawmill_platform.contracts.given import Given
from sawmill_platform.contracts.keys import Scope
from sawmill_service.dependencies import TheStore
from sawmill_service.drawing import BYTES_PER_VALUE, FIGURE_BYTES, check_slice, drawn_alpha_curve, result_of
from sawmill_service.http.bodies.sent_json import Sent
from sawmill_service.http.document.described_answers import OF_RESULT, drawn, refuses, stored
from sawmill_service.http.document.openapi_document import trying
from sawmill_service.http.problems import Refused
from sawmill_service.http.responses.answers import Hdf5, Png, file
from sawmill_service.http.responses.drawn import picture
from sawmill_service.http.route_rules import Router
from sawmill_service.routes.asked import linked
from sawmill_store.mill_files import VOLUME_FILE
from sawmill_vocabulary import ColorMap

Window = tuple[float, float]
MOST_TILES = 64
USUAL_TILES = 16

router = Router(prefix="/v1/reconstructions", tags=["reconstructions"], reading=Scope.READ)


class Bits(IntEnum):
    """Depth of a picture's grey."""

    EIGHT = 8
    SIXTEEN = 16


ValueOfVolume = Annotated[float, Field(ge=-LARGEST_NUMBER, le=LARGEST_NUMBER)]


class WindowQuery(Given):
    """Window of the values to draw, and their colours."""

    window_low: ValueOfVolume | None = Field(
        None,
        description="Value at the dark end, in the volume's unit; null: low end of the volume's window.",
        examples=[0.0],
    )
    window_high: ValueOfVolume | None = Field(
        None,
        description="Value at the bright end, in the volume's unit; null: high end of the volume's window.",
        examples=[0.03],
    )
    color_map: ColorMap = Field(ColorMap.GREY, description="Grey, or colours in which equal steps look equal.")


class SliceQuantity(StrEnum):
    """Values of a slice that are drawn."""

    ATTENUATION = "attenuation"
    DEVIATION = "deviation"


class SliceQuery(WindowQuery):
    """Options for drawing a slice."""

    show: SliceQuantity = Field(
        SliceQuantity.ATTENUATION,
        description="Values that are drawn; `deviation`: each pixel's standard deviation, where an earlier version "
        "computed it.",
    )
    bits: Bits = Field(
        Bits.EIGHT,
        description="Bits of a pixel. 8: for people, with scale bar and colour bar. 16: for programs, the values "
        "alone.",
    )
    scale_bar: bool = Field(default=True, description="Whether the scale bar is drawn.")

    @model_validator(mode="after")
    def _values_alone_are_grey(self) -> Self:
        if self.bits is Bits.SIXTEEN and self.color_map is not ColorMap.GREY:
            raise ValueError(f"bits=16 holds values, in grey; for color_map={self.color_map} ask for bits=8")
        return self


class MosaicQuery(WindowQuery):
    """Slices to draw next to one another."""

    count: Annotated[int, Field(ge=1, le=MOST_TILES)] | None = Field(
        None,
        description=f"Number of slices, evenly along the log; null: {USUAL_TILES}, or all where there are fewer.",
        examples=[USUAL_TILES],
    )
    slices: Annotated[str, AfterValidator(lambda text: parse_span("slices", text) and text)] | None = Field(
        None,
        description=f"Slices A:B or A:B:STEP instead, at most {MOST_TILES}.",
        examples=["0:2500:100"],
        json_schema_extra={"pattern": STEPPED_ROWS},
    )
    scale_bar: bool = Field(default=True, description="Whether the scale bar is drawn.")

    @model_validator(mode="after")
    def _one_choice(self) -> Self:
        if self.count is not None and self.slices is not None:
            raise ValueError("give count or slices, not both")
        return self


class SideQuery(WindowQuery):
    """Direction of a side view of the log."""

    along: Axis = Field("x", description="Axis along which the log is seen; the other one runs down the picture.")


@router.get(
    "/{reconstruction_id}/slices/{index}.png",
    response_class=Png,
    summary="Draw a slice",
    openapi_extra=trying(index=0, bits=8),
    responses=drawn(*OF_RESULT, "slice-not-found", "no-deviation", "empty-window"),
)
def get_slice(
    reconstruction_id: Identifier,
    index: Annotated[int, Path(ge=0, description="Number of the slice, from 0.", examples=[0])],
    query: Annotated[SliceQuery, Query()],
    request: Request,
    store: TheStore,
) -> Response:
    """Draw a slice; a row of the picture is +x, a column +y."""
    result = result_of(store.reconstructions, reconstruction_id)
    check_slice(result, index)

    def draw() -> bytes:
        from sawmill_calibration.pictures.images import image_png, image_png16
        from sawmill_calibration.pictures.pages import window_of
        from sawmill_formats.output import volume_reader

        path = store.reconstructions.files.volume(reconstruction_id)
        if query.show is SliceQuantity.DEVIATION:
            image = volume_reader.deviation_slice(path, result.shape, index)
            window = window_to_draw(query, window_of(image.data))
        else:
            image = volume_reader.volume_slice(path, result.shape, index)
            window = window_to_draw(query, result.value_range)
        if query.bits is Bits.SIXTEEN:
            return image_png16(image.data, window, pixel_mm=image.pixel_mm, first_pixel_mm=image.first_pixel_mm)
        return image_png(
            image.data,
            pixel_mm=image.pixel_mm if query.scale_bar else None,
            unit=image.unit,
            window=window,
            color_map=query.color_map,
        )

    size_bytes = BYTES_PER_VALUE * math.prod(result.shape[1:])
    return picture(request, (reconstruction_id, index, query), draw, size_bytes=size_bytes)


@router.get(
    "/{reconstruction_id}/mosaic.png",
    response_class=Png,
    summary="Draw slices along the log",
    openapi_extra=trying(count=16),
    responses=drawn(*OF_RESULT, "slice-not-found", "empty-window", "too-many-slices"),
)
def get_mosaic(
    reconstruction_id: Identifier, query: Annotated[MosaicQuery, Query()], request: Request, store: TheStore
) -> Response:
    """Draw slices in reading order with heights, all in one window; large ones are averaged down to 256 pixels."""
    from sawmill_calibration.pictures.log_pictures import TILE_PX

    result = result_of(store.reconstructions, reconstruction_id)
    window, indices = window_to_draw(query, result.value_range), _tiles(query, result.shape[0])

    def draw() -> bytes:
        from sawmill_calibration.pictures.log_pictures import mosaic_png
        from sawmill_formats.output import volume_reader

        slices = volume_reader.volume_slices(
            store.reconstructions.files.volume(reconstruction_id), result.shape, indices
        )
        return mosaic_png(
            ((image.data, image.label) for image in slices),
            pixel_mm=result.pixel_mm if query.scale_bar else None,
            unit=result.unit,
            window=window,
            color_map=query.color_map,
        )

    side = min(result.shape[1], TILE_PX)  # small slices are enlarged by whole factors
    values = result.shape[1] ** 2 + len(indices) * (side * -(-TILE_PX // side)) ** 2
    return picture(request, (reconstruction_id, "mosaic", query, window), draw, size_bytes=BYTES_PER_VALUE * values)


@router.get(
    "/{reconstruction_id}/side.png",
    response_class=Png,
    summary="Draw the log from the side",
    openapi_extra=trying(along="x"),
    responses=drawn(*OF_RESULT, "no-side-view", "empty-window"),
)
def get_side_view(
    reconstruction_id: Identifier, query: Annotated[SideQuery, Query()], request: Request, store: TheStore
) -> Response:
    """Draw the densest value behind each point of the log's side; the log runs to the right."""
    shape = result_of(store.reconstructions, reconstruction_id).shape

    def draw() -> bytes:
        from sawmill_calibration.pictures.log_pictures import side_view_png
        from sawmill_calibration.pictures.pages import window_of
        from sawmill_formats.output import volume_reader

        view = volume_reader.side_view(store.reconstructions.files.volume(reconstruction_id), shape, query.along)
        return side_view_png(view, window=window_to_draw(query, window_of(view.data)), color_map=query.color_map)

    size_bytes = BYTES_PER_VALUE * shape[0] * max(shape[1:])
    return picture(request, (reconstruction_id, "side", query), draw, size_bytes=size_bytes)


@router.get(
    "/{reconstruction_id}/alpha-curve.png",
    response_class=Png,
    summary="Draw how alpha was chosen",
    openapi_extra=trying(reconstruction_id="example-sparse"),
    responses=drawn(*OF_RESULT, "no-alpha-curve"),
)
def get_alpha_curve(reconstruction_id: Identifier, request: Request, store: TheStore) -> Response:
    """Draw the middle slice's L-curve of a `tikhonov` reconstruction, and generalised cross-validation if requested."""
    from sawmill_formats.output import volume_reader

    result_of(store.reconstructions, reconstruction_id)
    columns = volume_reader.alpha_curve(store.reconstructions.files.volume(reconstruction_id))
    made_of = (reconstruction_id, "alpha-curve")
    return picture(request, made_of, lambda: drawn_alpha_curve(columns), size_bytes=FIGURE_BYTES)


@router.get(
    "/{reconstruction_id}/volume.h5",
    response_class=Hdf5,
    summary="Get the volume as HDF5",
    responses=stored(*OF_RESULT),
)
def get_volume(reconstruction_id: Identifier, request: Request, store: TheStore) -> Response:
    """Return `/entry/reconstruction/data`, float32 (slice, x, y). `Range` requests are answered."""
    result_of(store.reconstructions, reconstruction_id)
    files = store.reconstructions.files
    path = files.unverified(kinds.RECONSTRUCT, reconstruction_id, VOLUME_FILE)
    name = f"{store.reconstructions.file_name(reconstruction_id)}.h5"
    return file(request, path, "application/x-hdf5", save_as=name, digest=files.verified.digest)


@router.put(
    "/{reconstruction_id}/name",
    needs=Scope.SUBMIT,
    summary="Name a reconstruction",
    openapi_extra=trying(body={"name": "spruce with a nail"}),
    responses=refuses("reconstruction-not-found"),
)
def rename_reconstruction(
    reconstruction_id: Identifier, named: Sent[ReconstructionName], store: TheStore
) -> Reconstruction:
    """Give a reconstruction a name of its own, or none; the history of names is in the audit."""
    renamed: Reconstruction = linked(contract.DECLARATION, store.reconstructions.rename(reconstruction_id, named.name))
    return renamed


@router.put(
    "/{reconstruction_id}/marks/{mark_id}",
    needs=Scope.SUBMIT,
    summary="Keep a mark in a slice",
    openapi_extra=trying(
        mark_id="knot-1", body={"kind": "ruler", "slice": 0, "ends_mm": [[-20.0, 0.0], [20.0, 15.0]], "note": "knot"}
    ),
    responses=refuses(*OF_RESULT, "slice-not-found", "too-many-marks"),
)
def mark_reconstruction(
    reconstruction_id: Identifier, mark_id: Identifier, mark: Sent[MarkRequest], store: TheStore
) -> Reconstruction:
    """Keep a ruler or a region under an id of your choice, in place of the mark that has it; everybody sees it."""
    check_slice(result_of(store.reconstructions, reconstruction_id), mark.slice)
    marked: Reconstruction = linked(contract.DECLARATION, store.reconstructions.mark(reconstruction_id, mark_id, mark))
    return marked


@router.delete(
    "/{reconstruction_id}/marks/{mark_id}",
    needs=Scope.SUBMIT,
    status_code=204,
    summary="Remove a mark",
    openapi_extra=trying(mark_id="knot-1"),
    responses=refuses("reconstruction-not-found"),
)
def unmark_reconstruction(reconstruction_id: Identifier, mark_id: Identifier, store: TheStore) -> None:
    """Remove a ruler or a region; one that is not there is no error."""
    store.reconstructions.mark(reconstruction_id, mark_id, None)


def window_to_draw(query: WindowQuery, usual: Window) -> Window:
    """Complete the window of a query by the default window."""
    low = usual[0] if query.window_low is None else query.window_low
    high = usual[1] if query.window_high is None else query.window_high
    if not low < high:
        raise Refused(422, "empty-window", f"window_low must be below window_high, not {low} and {high}")
    return low, high


def _tiles(query: MosaicQuery, available: int) -> Sequence[int]:
    if query.slices is None:
        from sawmill_calibration.pictures.log_pictures import spread

        return spread(query.count or USUAL_TILES, available)
    span = parse_span("slices", query.slices)
    if span.stop > available:
        raise Refused(404, "slice-not-found", f"slices must be within 0:{available}, not {query.slices}")
    tiles = range(available)[span]
    if len(tiles) > MOST_TILES:
        raise Refused(
            422, "too-many-slices", f"slices must name at most {MOST_TILES}, not {len(tiles)}: take a larger STEP"
        )
    return tiles
