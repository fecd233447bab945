"""Page that the demo writes: a log before and after, the verdict, then each scan next to its ground truth."""

from dataclasses import dataclass, field
from pathlib import Path

from sawmill_mill.two_questions import VERDICTS, TwoQuestions
from sawmill_vocabulary import Verdict
from sawmill_worker.pictures.report_page import page_templates


@dataclass(frozen=True)
class LogPair:
    """A log with two geometries: files of the pictures, RMS errors of the rays, and assumptions of the first geometry.

    Attributes
    ----------
    assumed
        Differences of the geometry by tape measure from the truth, for example "source shift +3 mm".
    time_s
        Duration of the calibration.
    """

    before: str
    after: str
    before_mm: float
    after_mm: float
    assumed: list[str]
    time_s: float


@dataclass
class Section:
    """Section on a scan: rows of a table under `head`, facts (label, value), pictures (file, caption), files.

    Attributes
    ----------
    report : str
        File of the calibration's report.
    files : list of (str, str)
        Name and content of each file.
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
        """Meaning of the verdict."""
        return VERDICTS[self.verdict]


def write_page(path: Path, sections: list[Section]) -> None:
    """Write index.html next to the files that the page names. The first section has a log."""
    page = page_templates().get_template("demo.html").render(sections=sections)
    path.write_text(page.lstrip(), encoding="utf-8")
