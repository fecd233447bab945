"""What a file does not say, as questions: about the scanner, the phantom, the numbers, the angles, the array."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

from sawmill_contracts.inspections import FilePart, InspectedReading, Inspection, InspectionResult
from sawmill_contracts.phantoms import PhantomState, StoredPhantom
from sawmill_contracts.scanners import StoredScanner
from sawmill_store.store import Store
from sawmill_vocabulary import DataKind

# Of each list; a mill has a few scanners and phantoms.
OFFERED = 200
# Among which one with a phantom is looked for.
LAST_SCANS = 20
# A stack or one row of it: views and cells at least.
LEAST_AXES = 2


@dataclass(frozen=True)
class Questions:
    """What is asked about an inspected file, and what it says itself.

    Attributes
    ----------
    inspection : Inspection
        The file's; its reading is None while it is not known which array is meant.
    datasets : sequence of FilePart
        The arrays of which one must be named; empty where that is no question.
    scanners, phantoms
        To choose from; the scanners whose detector fits the file stand first.
    data : DataKind or None
        What the numbers can only be; None: that is asked.
    counts_possible : bool
        Whether the file carries the flat fields that counts need.
    angles : bool
        Whether the views' angles are asked for.
    answers : mapping
        What was answered, or is proposed, by the fields' names.
    """

    inspection: Inspection
    datasets: list[FilePart]
    scanners: list[StoredScanner]
    phantoms: list[StoredPhantom]
    data: DataKind | None
    counts_possible: bool
    angles: bool
    answers: Mapping[str, str]

    @property
    def reading(self) -> InspectedReading | None:
        """What would be read."""
        return None if self.inspection.result is None else self.inspection.result.reading

    @property
    def full_turn(self) -> str:
        """START:STEP of a full turn in equal steps."""
        views = self.reading.shape.views if self.reading else 0
        return f"0:{360 / views:.10g}" if views else ""

    def answer(self, field: str) -> str:
        """What was answered, or is proposed; empty for neither."""
        return self.answers.get(field, "")

    def fits(self, scanner: StoredScanner) -> bool:
        """Whether the file has as many cells as the scanner's detector."""
        return self.reading is None or scanner.constants.num_detector_pixels == self.reading.shape.detector


def questions_of(store: Store, inspection: Inspection, answers: Mapping[str, str]) -> Questions:
    """About a file that was inspected; `answers` as far as there are any, else proposals stand in their place."""
    result = inspection.result
    assert result is not None  # noqa: S101 - its state says so
    missing = {part.field for part in result.missing}
    given = {name: value for name, value in answers.items() if value}
    questions = Questions(
        inspection=inspection,
        datasets=_arrays(result) if "dataset" in missing else [],
        scanners=store.scanners.page(limit=OFFERED).items,
        phantoms=usable_phantoms(store),
        data=_only_possible(result),
        counts_possible=result.reading is not None and result.reading.flats is not None,
        angles="angles_deg" in missing,
        answers=given,
    )
    questions.scanners.sort(key=lambda scanner: not questions.fits(scanner))
    return replace(questions, answers=_proposed(store, questions) | given)


def _proposed(store: Store, questions: Questions) -> dict[str, str]:
    """The only scanner whose detector fits, and the phantom that its last scan with one showed."""
    fitting = [each.id for each in questions.scanners if questions.fits(each)]
    scanner_id = questions.answers.get("scanner_id") or (fitting[0] if len(fitting) == 1 else "")
    if not scanner_id:
        return {}
    last = store.scans.page(scanner_id=scanner_id, limit=LAST_SCANS).items
    shown = (scan.phantom_id for scan in last if scan.phantom_id in {each.id for each in questions.phantoms})
    return {"scanner_id": scanner_id, "phantom_id": next(shown, None) or ""}


def usable_phantoms(store: Store) -> list[StoredPhantom]:
    """Those that can be used and that no newer measurement has replaced."""
    replaced = store.phantoms.replaced()
    listed = store.phantoms.page(limit=OFFERED).items
    return [each for each in listed if each.state is PhantomState.READY and each.id not in replaced]


def _arrays(result: InspectionResult) -> list[FilePart]:
    return [part for part in result.parts if part.count == 1 and len(part.shape or ()) >= LEAST_AXES]


def _only_possible(result: InspectionResult) -> DataKind | None:
    """Counts where there are flat fields, with which line integrals are refused; or what this product wrote."""
    if result.reading is not None and result.reading.flats is not None:
        return DataKind.COUNTS
    return DataKind.LINE_INTEGRALS if result.own_kind == "scan" else None
