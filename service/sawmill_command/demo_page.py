"""The page that the demo writes: one log before and after, the verdict, then each scan beside its truth."""

from dataclasses import dataclass, field
from pathlib import Path

from sawmill_mill.two_questions import VERDICTS, TwoQuestions
from sawmill_vocabulary import Verdict
from sawmill_worker.pictures.report_page import page_templates


@dataclass(frozen=True)
class LogPair:
    """One log with two geometries: the pictures' files, the rays' RMS errors, and what was assumed of the first.

    Attributes
    ----------
    assumed
        By what the geometry of a tape measure differs from the truth, as "source shift +14 mm".
    time_s
        That the calibration took.
    """

    before: str
    after: str
    before_mm: float
    after_mm: float
    assumed: list[str]
    time_s: float


@dataclass
class Section:
    """One scan: rows of a table under `head`, facts (label, value), pictures (file, caption), files (name, content).

    Attributes
    ----------
    report : str
        The file of the calibration's report.
    """

    title: str
    text: str
    verdict: Verdict
    questions: TwoQuestions
    report: str
    log: LogPair | None = None
    head: tuple[str, ...] = ()
    rows: list[tuple[str, ...]] = field(default_factory=list)
    facts: list[tuple[str, str]] = field(default_factory=list)
    pictures: list[tuple[str, str]] = field(default_factory=list)
    files: list[tuple[str, str]] = field(default_factory=list)

    @property
    def sentence(self) -> str:
        """What the verdict means."""
        return VERDICTS[self.verdict]


def write_page(path: Path, sections: list[Section]) -> None:
    """Write index.html; every file that it names lies beside it. The first section has a log."""
    page = page_templates().get_template("demo.html").render(sections=sections)
    path.write_text(page.lstrip(), encoding="utf-8")
