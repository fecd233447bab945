"""Pages of phantoms: the list, how well sizes are known, a form for a new phantom, and the plan of a calibration."""

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import date, datetime, timedelta
from typing import Annotated, NamedTuple

from babel.dates import format_timedelta
from fastapi import Body, Query, Request, Response
from fastapi.responses import HTMLResponse, RedirectResponse
from markupsafe import Markup
from pydantic import Field, JsonValue, TypeAdapter, ValidationError
from pydantic_core import to_json

from sawmill_calibration.pictures.phantom_drawing import outline_svg, shown_svg
from sawmill_contracts import kinds
from sawmill_contracts.phantoms import (
    DrawnShape,
    PhantomDrawing,
    PhantomPicture,
    SizeMeasurement,
    StoredPhantom,
    faults_of,
)
from sawmill_contracts.plans import Plan
from sawmill_contracts.scanners import StoredScanner
from sawmill_mill.two_questions import TwoQuestions
from sawmill_platform.contracts.base import Contract, Identifier, read_strictly
from sawmill_platform.contracts.given import Given
from sawmill_platform.contracts.keys import Scope
from sawmill_platform.errors import Conflict, NotFound, if_found
from sawmill_service.dependencies import TheSettings, TheStore
from sawmill_service.http.problems import complaint
from sawmill_service.http.responses.answers import Paging, Svg, file
from sawmill_service.http.responses.drawn import picture
from sawmill_service.http.route_rules import Router
from sawmill_service.pages.calibrate.calibrate_words import TheWizardAddress
from sawmill_service.pages.frame.languages import Formats
from sawmill_service.pages.frame.page_frame import PageFrame, ThePage
from sawmill_service.pages.frame.verdicts import ShownQuestion, shown_pair
from sawmill_store.scans.phantoms import Phantoms
from sawmill_store.store import Store
from sawmill_vocabulary import Shape

# Time from the first warning to the expiry: enough to find the caliper.
SOON = timedelta(days=30)
# Ages are given in a unit from two of that unit on: 14 months are not a year.
_TWO = 2.0


@dataclass(frozen=True)
class SizeKnown:
    """Accuracy of a phantom's size, for people: a word with its tone, and a sentence."""

    tone: str
    word: str
    sentence: str


def size_text(drawing: PhantomDrawing, formats: Formats) -> str:
    """Write the size along x and y."""
    along_x, along_y = drawing.extent_mm
    return f"{formats.number(along_x, 1)} \N{MULTIPLICATION SIGN} {formats.mm(along_y, 1)}"


def size_known(phantom: StoredPhantom, page: PageFrame, today: date) -> SizeKnown:
    """Judge how well the size is known, by the measurements and their own expiry."""
    measured = phantom.drawing.measurements if phantom.drawing else []
    if not measured:
        return _unmeasured(phantom, page)
    _ = page.text.gettext
    when = _last_measured(measured, page, today)
    if any(each.expired(today) for each in measured):
        return SizeKnown("watch", _("Measure again"), _("%(when)s: measure it again.") % {"when": when})
    if phantom.drawing is not None and (unmeasured := phantom.drawing.axis_as_drawn) is not None:
        axes = {"axis": "x" if unmeasured == "y" else "y", "other": unmeasured}
        sentence = _("%(when)s, along %(axis)s only: along %(other)s it is as it was drawn. Measure that side too.")
        return SizeKnown("watch", _("Measured along %(axis)s only") % axes, sentence % {"when": when, **axes})
    ends = min((each.expires_on for each in measured if each.expires_on is not None), default=None)
    formats = page.formats
    if ends is not None and ends - today <= SOON:
        sentence = _("%(when)s. Measure it again by %(day)s.") % {"when": when, "day": formats.day(ends.isoformat())}
        return SizeKnown("watch", _("Measure soon"), sentence)
    if ends is not None:
        sentence = _("%(when)s, good until %(day)s.") % {"when": when, "day": formats.day(ends.isoformat())}
        return SizeKnown("good", _("Measured"), sentence)
    return SizeKnown("good", _("Measured"), _("%(when)s, with no day on which to repeat it.") % {"when": when})


def _unmeasured(phantom: StoredPhantom, page: PageFrame) -> SizeKnown:
    _ = page.text.gettext
    if phantom.built_in:
        return SizeKnown("idle", _("As published"), _("The size of one published board: measure yours."))
    return SizeKnown("idle", _("Not measured"), _("Its size is as it was drawn: measure its sides."))


def _last_measured(measured: list[SizeMeasurement], page: PageFrame, today: date) -> str:
    """Write when the phantom was measured last, and with what."""
    _ = page.text.gettext
    last = max(measured, key=lambda each: each.measured_on or date.min)
    if last.measured_on is None:
        when = _("Measured, it is not known when")
    elif last.measured_on == today:
        when = _("Measured today")
    elif last.measured_on > today:
        when = _("Measured on %(day)s") % {"day": page.formats.day(last.measured_on.isoformat())}
    else:
        ago = format_timedelta(
            last.measured_on - today, granularity="day", threshold=_TWO, add_direction=True, locale=page.language
        )
        when = _("Measured %(ago)s") % {"ago": ago}
    return when if last.instrument is None else _("%(when)s by %(what)s") % {"when": when, "what": last.instrument}


PHANTOMS = "/phantoms"
# Phantoms on a page of the list; a mill has one or two.
LISTED = 50
# Number of scanners for which a plan can be requested.
OFFERED = 200
# Signature, length and name of the first chunk, width, height (PNG, section 11.2.2).
_PNG_HEAD = struct.Struct(">16xII")

router = Router(include_in_schema=False, reading=Scope.READ)


class ListedPhantom(NamedTuple):
    """Row of the list."""

    phantom: StoredPhantom
    size: str
    known: SizeKnown


class PictureShown(NamedTuple):
    """Size of a phantom's picture, mm; the rotation centre is the middle of the picture."""

    width_mm: float
    height_mm: float


class _Outline(Given):
    """A shape of a drawing that is being made."""

    shape: DrawnShape


_OUTLINE = TypeAdapter(_Outline)


class ShapeFault(Contract):
    """Reason why a drawing is not yet valid."""

    shape: int | None = Field(description="The shape's number, counted from 0; null: all of them together.")
    sentence: str


class Preview(Contract):
    """A drawing that is being made, as far as it can be drawn."""

    svg: str | None
    faults: list[ShapeFault]


@router.get(PHANTOMS)
def phantoms(page: ThePage, store: TheStore, paging: Annotated[Paging, Query()]) -> HTMLResponse:
    """List the phantoms that no newer measurement has replaced, the newest first."""
    listed, replaced, today = store.phantoms.page(after=paging.after, limit=LISTED), store.phantoms.replaced(), _today()
    rows = [
        ListedPhantom(
            each, size_text(each.drawing, page.formats) if each.drawing else "", size_known(each, page, today)
        )
        for each in listed.items
        if each.id not in replaced
    ]
    return page.answer("phantoms.html", rows=rows, following=listed.next)


@router.get(f"{PHANTOMS}/new")
def new_phantom(page: ThePage, settings: TheSettings, wizard: TheWizardAddress) -> HTMLResponse:
    """Show the forms to draw a phantom or to upload a picture of one; they lead back to a scan that waits for it."""
    return page.answer("new_phantom.html", max_picture_bytes=settings.max_picture_bytes, wizard=wizard)


@router.post(f"{PHANTOMS}/preview", needs=Scope.SUBMIT)
def preview(page: ThePage, shapes: Annotated[list[JsonValue], Body(embed=True, max_length=200)]) -> Preview:
    """Draw what can be drawn of shapes that need not be right yet, and report the faults of each shape."""
    read: dict[int, Shape] = {}
    faults: list[ShapeFault] = []
    for number, shape in enumerate(shapes):
        try:
            read[number] = read_strictly(_OUTLINE, to_json({"shape": shape})).shape
        except ValidationError as error:
            location, message = complaint(error.errors()[0])
            place = ".".join(part for part in location.split(".") if part not in {"shape", "polygon", "disc"})
            faults.append(ShapeFault(shape=number, sentence=f"{place} {message}".strip()))
    faults += [ShapeFault(shape=number, sentence=sentence) for number, sentence in faults_of(read)]
    if not read:
        return Preview(svg=None, faults=faults)
    wrong = {fault.shape for fault in faults if fault.shape is not None}
    svg = shown_svg(page.text.gettext("The drawing so far"), read, wrong=wrong, numbered=True)
    return Preview(svg=svg, faults=faults)


@router.get(PHANTOMS + "/{phantom_id}")
def phantom(phantom_id: Identifier, page: ThePage, store: TheStore) -> HTMLResponse:
    """Show a phantom: its drawing, its measurements, its plans."""
    return _phantom_page(phantom_id, page, store)


@router.get(PHANTOMS + "/{phantom_id}/plans")
def plans(phantom_id: Identifier, page: ThePage, store: TheStore) -> HTMLResponse:
    """Return the part of the phantom's page with the newest plans, for when a plan has ended."""
    return page.answer("phantom_plans.html", plans=list(plan_views(store, phantom_id, page)))


@router.get(PHANTOMS + "/{phantom_id}/outline.svg")
def outline(phantom_id: Identifier, request: Request, store: TheStore) -> Response:
    """Return a small picture of the phantom's shapes, for lists."""
    drawing = store.phantoms.get(phantom_id).drawing
    if drawing is None:
        raise NotFound("drawing", phantom_id)
    return picture(request, ("outline", drawing), lambda: outline_svg(drawing), answer=Svg)


@router.get(PHANTOMS + "/{phantom_id}/picture.png")
def uploaded_picture(phantom_id: Identifier, request: Request, store: TheStore) -> Response:
    """Return the picture from which the outline was traced."""
    store.phantoms.picture(phantom_id)
    return file(request, store.phantoms.files.upload(kinds.TRACE_PHANTOM, phantom_id), "image/png")


@router.post(PHANTOMS + "/{phantom_id}/delete", needs=Scope.ADMIN)
def delete(phantom_id: Identifier, page: ThePage, store: TheStore) -> Response:
    """Delete a phantom, or show what still needs it."""
    try:
        store.phantoms.delete(phantom_id)
    except Conflict as refused:
        return _phantom_page(phantom_id, page, store, refused=str(refused), status=409)
    return RedirectResponse(PHANTOMS, status_code=303)


def _phantom_page(
    phantom_id: str, page: PageFrame, store: Store, *, refused: str | None = None, status: int = 200
) -> HTMLResponse:
    stored, today = store.phantoms.get(phantom_id), _today()
    drawing = stored.drawing
    return page.answer(
        "phantom.html",
        status=status,
        phantom=stored,
        size=size_text(drawing, page.formats) if drawing else None,
        known=size_known(stored, page, today),
        svg=Markup(shown_svg(drawing.name, dict(enumerate(drawing.shapes)))) if drawing else None,  # noqa: S704 - ours
        shown=_picture_of(stored, store.phantoms),
        newer=store.phantoms.followers().get(phantom_id),
        plans=list(plan_views(store, phantom_id, page)),
        # First those whose calibration has a geometry to plan with.
        scanners=sorted(store.scanners.page(limit=OFFERED).items, key=lambda each: each.active_calibration_id is None),
        today=today,
        refused=refused,
    )


def _picture_of(phantom: StoredPhantom, phantoms: Phantoms) -> PictureShown | None:
    """Return the size of the uploaded picture; None where the phantom was drawn, or the upload is no PNG."""
    if phantom.job_id is None:
        return None
    uploaded: PhantomPicture = phantoms.picture(phantom.id)
    with phantoms.files.upload(kinds.TRACE_PHANTOM, phantom.id).open("rb") as stream:
        head = stream.read(_PNG_HEAD.size)
    if len(head) < _PNG_HEAD.size or not head.startswith(b"\x89PNG"):
        return None
    width, height = _PNG_HEAD.unpack(head)
    return PictureShown(uploaded.width_mm, uploaded.width_mm * height / width) if width else None


def _today() -> date:
    return datetime.now().astimezone().date()


SHOWN = 3


@dataclass(frozen=True)
class PlanView:
    """A plan as its page shows it."""

    plan: Plan
    scanner: StoredScanner | None  # None: the scanner was deleted since
    questions: list[ShownQuestion]  # empty while there is no answer, or no scanner with tolerances for a comparison


def plan_views(store: Store, phantom_id: str, page: PageFrame) -> Iterator[PlanView]:
    """Yield the newest plans with a phantom, judged by the present tolerances."""
    for plan in store.plans.page(phantom_id=phantom_id, limit=SHOWN).items:
        scanner = if_found(store.scanners.get, plan.scanner_id)
        questions: list[ShownQuestion] = []
        if plan.result is not None and scanner is not None:
            questions = shown_pair(TwoQuestions.of_plan(plan.result, scanner.tolerances), page.text, page.formats)
        yield PlanView(plan, scanner, questions)
