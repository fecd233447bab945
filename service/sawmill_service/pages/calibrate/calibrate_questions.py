"""Questions about what a file does not say: the scanner, the phantom, the numbers, the angles, the array."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

from sawmill_contracts.inspections import FilePart, InspectedReading, Inspection
from sawmill_contracts.phantoms import PhantomState, StoredPhantom
from sawmill_contracts.scanners import StoredScanner
from sawmill_mill.calibration_differences import Misfit, misfit
from sawmill_service.pages.frame.languages import natural_order
from sawmill_store.scans.phantoms import Phantoms
from sawmill_store.scans.scans import Scans
from sawmill_store.store import Store
from sawmill_vocabulary import DataKind

# Longest list; a mill has a few scanners and phantoms.
OFFERED = 200
# Number of scans in which the last one with a phantom is searched.
LAST_SCANS = 20
# A stack or one row of it: views and cells at least.
LEAST_AXES = 2


@dataclass(frozen=True)
class Questions:
    """Questions about an inspected file, and what the file says itself."""

    inspection: Inspection  # its reading is None while it is not known which array is meant
    datasets: list[FilePart]  # arrays of which one must be named; empty where that is no question
    # fitting, unfit: scanners that can have made the file, and the others with what contradicts it, in natural order.
    fitting: list[StoredScanner]
    unfit: list[tuple[StoredScanner, Misfit]]
    # Scanner that was chosen before the file was known, where the file is not from it; nothing is proposed then.
    foreign: tuple[StoredScanner, Misfit] | None
    phantoms: list[StoredPhantom]
    data: DataKind | None  # the only possible kind of the numbers; None: the kind is a question
    counts_possible: bool  # True if the file has the flat fields that counts need
    angles: bool  # True if the angles of the views are a question
    answers: Mapping[str, str]  # given or proposed answers, by the names of the fields

    @property
    def reading(self) -> InspectedReading | None:
        """Reading of the file that a scan would have; None where there is none yet."""
        return None if self.inspection.result is None else self.inspection.result.reading

    @property
    def full_turn(self) -> str:
        """START:STEP of a full turn in equal steps."""
        views = self.reading.shape.views if self.reading else 0
        return f"0:{360 / views:.10g}" if views else ""

    def answer(self, field: str) -> str:
        """Return the given or proposed answer; empty where there is neither."""
        return self.answers.get(field, "")


def questions_of(store: Store, inspection: Inspection, answers: Mapping[str, str]) -> Questions:
    """Collect the questions about an inspected file; proposals fill in for answers that are missing."""
    result = inspection.result
    assert result is not None  # noqa: S101 - its state says so
    missing = {part.field for part in result.missing}
    answered = {name: value for name, value in answers.items() if value}
    scanners = sorted(store.scanners.page(limit=OFFERED).items, key=lambda each: natural_order(each.name))
    judged = [(each, result.reading and misfit(each.constants, result.reading)) for each in scanners]
    unfit = [(scanner, found) for scanner, found in judged if found]
    foreign = next((each for each in unfit if each[0].id == answered.get("scanner_id")), None)
    if foreign is not None:
        del answered["scanner_id"]
    arrays = [part for part in result.parts if part.count == 1 and len(part.shape or ()) >= LEAST_AXES]
    # Counts have flat fields, line integrals have none; this product writes line integrals.
    has_flats = result.reading is not None and result.reading.flats is not None
    written = DataKind.LINE_INTEGRALS if result.own_kind == "scan" else None
    questions = Questions(
        inspection=inspection,
        datasets=arrays if "dataset" in missing else [],
        fitting=[scanner for scanner, found in judged if not found],
        unfit=unfit,
        foreign=foreign,
        phantoms=usable_phantoms(store.phantoms),
        data=DataKind.COUNTS if has_flats else written,
        counts_possible=has_flats,
        angles="angles_deg" in missing,
        answers=answered,
    )
    return questions if foreign else replace(questions, answers=_proposed(store.scans, questions) | answered)


def _proposed(scans: Scans, questions: Questions) -> dict[str, str]:
    """Propose the only scanner that fits, and the phantom that its last scan with a phantom showed."""
    fitting = [each.id for each in questions.fitting]
    scanner_id = questions.answers.get("scanner_id") or (fitting[0] if len(fitting) == 1 else "")
    if not scanner_id:
        return {}
    last = scans.page(scanner_id=scanner_id, limit=LAST_SCANS).items
    shown = (scan.phantom_id for scan in last if scan.phantom_id in {each.id for each in questions.phantoms})
    return {"scanner_id": scanner_id, "phantom_id": next(shown, None) or ""}


def usable_phantoms(phantoms: Phantoms) -> list[StoredPhantom]:
    """Select the phantoms that can be used and that no newer measurement has replaced."""
    replaced = phantoms.replaced()
    listed = phantoms.page(limit=OFFERED).items
    return [each for each in listed if each.state is PhantomState.READY and each.id not in replaced]
