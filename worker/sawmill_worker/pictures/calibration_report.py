"""A calibration's report on one page: first the facts for a technician, then the evidence.

The report is drawn with matplotlib's figure objects, never through pyplot, so that there is no state and no display.
All contents come from the result and the arrays in the calibration's HDF5 file.
"""

import textwrap
from collections.abc import Iterator

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure, FigureBase, SubFigure
from matplotlib.transforms import Bbox

from sawmill_contracts.calibrations import CalibrationResult, FoundGeometry, Provenance
from sawmill_mill.next_step import NextStep, step_alone
from sawmill_vocabulary import ReconstructionMethod
from sawmill_vocabulary.calibration_arrays import CalibrationArrays, LogImages
from sawmill_vocabulary.messages import ENGLISH, Reader
from sawmill_vocabulary.texts import N_
from sawmill_worker.pictures.calibration_table import calibration_table
from sawmill_worker.pictures.fit_panels import draw_residual, draw_search
from sawmill_worker.pictures.image_panels import draw_logs, draw_phantom, encoded
from sawmill_worker.pictures.parameter_panels import draw_frame_pairs, draw_theta_and_twin

WIDTH_IN = 14.0
LINE_IN = 0.27
COLUMNS = 150
ALARM = "#b71c1c"
COLORS = {"good": "#2e7d32", "watch": "#b26a00", "bad": ALARM, "idle": "#555555"}
# Note for the reader on the phantom's image.
BY_METHOD = {
    ReconstructionMethod.TOTAL_VARIATION: (
        "\n(total variation, since the views do not go all round:\nedges along no ray of theirs are guessed)"
    )
}


def report_png(
    result: CalibrationResult, arrays: CalibrationArrays, step: NextStep | None = None, reader: Reader = ENGLISH
) -> bytes:
    """Draw the report of a calibration as a PNG file; arguments and errors as for `report_figure`."""
    return encoded(report_figure(result, arrays, step or step_alone(result), reader))


def report_figure(
    result: CalibrationResult, arrays: CalibrationArrays, step: NextStep, reader: Reader = ENGLISH
) -> Figure:
    """Draw the report of a calibration.

    Parameters
    ----------
    step : NextStep
        The next step, which stands at the top.
    reader : Reader
        Language of the sentences; the numbers and the evidence below them are in English.

    Raises
    ------
    ValueError
        The numbers of views and angles differ.
    """
    residual, angles_deg = arrays.residual, np.rad2deg(arrays.angles_rad)
    if len(angles_deg) != len(residual):
        raise ValueError(f"the residual {residual.shape} and {len(angles_deg)} angles do not agree")
    lines = list(_lines(result, step, reader))
    heights = {"head": 1.0 + LINE_IN * len(lines), "found": 6.1, "fit": 5.4, "pairs": 6.4}
    if arrays.log is not None:
        heights = {"head": heights["head"], "found": heights["found"], "log": 6.6, **heights}
    figure = Figure(figsize=(WIDTH_IN, sum(heights.values())), layout="constrained")
    grid = figure.add_gridspec(len(heights), 1, height_ratios=list(heights.values()))
    parts = {name: figure.add_subfigure(grid[row]) for row, name in enumerate(heights)}
    _draw_head(parts["head"], result.phantom, step, reader, lines, heights["head"])
    _draw_found(parts["found"], result, arrays)
    if arrays.log is not None:
        _draw_log(parts["log"], arrays.log)
    _draw_fit(parts["fit"], result, arrays)
    _draw_pairs(parts["pairs"], result)
    return figure


def overlay_png(provenance: Provenance, arrays: CalibrationArrays) -> bytes:
    """Draw only the phantom's reconstruction under its outlines; arguments as for `report_figure`."""
    figure = Figure(figsize=(9.0, 8.2), layout="constrained")
    figure.suptitle(f"{provenance.phantom} with the geometry found", fontsize=15, fontweight="bold")
    _draw_phantom(figure, figure.add_subplot(), arrays)
    return encoded(figure)


def _lines(result: CalibrationResult, step: NextStep, reader: Reader) -> Iterator[tuple[str, str]]:
    """Yield the lines below the title, each with a colour: the next step, reasons, changes and processing steps."""
    words, comparison = step.reason.in_words(reader), result.comparison
    for sentence in (f"{words.headline} {words.action}", step.english):
        yield from ((line, COLORS[step.card_tone]) for line in textwrap.wrap(sentence or "", COLUMNS))
    explained = [(each, "black") for each in result.other_explanations]
    if comparison is not None:
        explained.append((comparison.explanation, "black" if comparison.within_tolerance else ALARM))
    for each, color in (*explained, *((done, "0.35") for done in result.findings_in_scan)):
        text = each.sentence if each.reason is None else each.reason.in_words(reader).text
        for line in textwrap.wrap(text, COLUMNS, initial_indent="•  ", subsequent_indent="    "):
            yield line, color


def _draw_head(
    part: SubFigure, phantom: str, step: NextStep, reader: Reader, lines: list[tuple[str, str]], height_in: float
) -> None:
    color = COLORS[step.card_tone]
    badge = {"boxstyle": "round,pad=0.45", "facecolor": color, "edgecolor": "none"}
    top = 1 - 0.2 / height_in
    part.text(
        0.012,
        top,
        reader.words(N_("Calibration with %(phantom)s")) % {"phantom": phantom},
        fontsize=19,
        fontweight="bold",
        va="top",
    )
    part.text(
        0.985,
        top,
        reader.words(step.word).upper(),
        fontsize=17,
        fontweight="bold",
        color="white",
        ha="right",
        va="top",
        bbox=badge,
    )
    for number, (line, line_color) in enumerate(lines):
        part.text(0.012, 1 - (0.85 + LINE_IN * number) / height_in, line, fontsize=12.5, va="top", color=line_color)


def _draw_found(part: SubFigure, result: CalibrationResult, arrays: CalibrationArrays) -> None:
    grid = part.add_gridspec(1, 2, width_ratios=(1, 1.02))
    _draw_phantom(part, part.add_subplot(grid[0]), arrays)
    _draw_table(part.add_subplot(grid[1]), calibration_table(result))


def _draw_phantom(figure: FigureBase, ax: Axes, arrays: CalibrationArrays) -> None:
    image = arrays.phantom_image
    ax.set_title("the phantom, reconstructed with the geometry found" + BY_METHOD.get(arrays.phantom_image_method, ""))
    draw_phantom(figure, ax, image, arrays.phantom_field_mm, arrays.phantom_outlines_mm)
    if not image.any():
        ax.text(
            0.5, 0.5, "no image: the views\ndo not go all round", transform=ax.transAxes, ha="center", color="white"
        )


def _draw_log(part: SubFigure, log: LogImages) -> None:
    images = [(f"the log in row {log.row}, with this calibration", log.after)]
    if log.before is None:
        part.text(0.75, 0.5, "no geometry from before\nthat shows it", ha="center", fontsize=12)
    else:
        images.insert(0, (f"the log in row {log.row}, {log.before_with.phrase}", log.before))
    draw_logs(part, images, log.field_mm, "")


def _draw_fit(part: SubFigure, result: CalibrationResult, arrays: CalibrationArrays) -> None:
    residual_part, search_part = _side_by_side(part, 1.9, 1)
    residual_part.suptitle(
        f"measured less model: RMS {result.residual.rms:.3g}, {100 * result.residual.relative:.2g} % of the sinogram's"
    )
    draw_residual(
        residual_part,
        arrays.residual,
        np.rad2deg(arrays.angles_rad),
        result.scanner.detector_pitch_mm,
    )
    search, history = result.search, arrays.search_history
    search_part.suptitle(f"search: {search.evaluations} evaluations,\n{search.method}")
    # The default search reports relative residuals; the published search reports a correlation, which is below zero.
    of_residuals = bool((history[:, 1] > 0.0).all())
    draw_search(search_part.add_subplot(), history, final=result.residual.relative if of_residuals else None)


def _draw_pairs(part: SubFigure, geometry: FoundGeometry) -> None:
    frame_part, theta_part = _side_by_side(part, 1.15, 1)
    covariance = np.zeros((5, 5)) if geometry.covariance is None else np.array(geometry.covariance)
    if np.count_nonzero(np.diag(covariance)) < 2:
        frame_part.suptitle("source frame: no error bars, so no ellipses")
    else:
        frame_part.suptitle("source frame: 95 % ellipse of each pair, from the answer")
        draw_frame_pairs(frame_part, covariance)
    theta_part.suptitle(
        "theta: source shift 0, no twin"
        if geometry.theta_twin is None
        else "theta and its twin: the same sinogram, exactly"
    )
    draw_theta_and_twin(theta_part, geometry)


def _side_by_side(part: SubFigure, *widths: float) -> list[SubFigure]:
    grid = part.add_gridspec(1, len(widths), width_ratios=widths)
    return [part.add_subfigure(grid[column]) for column in range(len(widths))]


def _draw_table(ax: Axes, rows: list[tuple[str, str]]) -> None:
    ax.set_axis_off()
    stripes = [["0.95" if line % 2 == 0 else "white"] * 2 for line in range(len(rows))]
    table = ax.table(rows, stripes, cellLoc="right", colWidths=(0.4, 0.6), bbox=Bbox.unit())
    table.auto_set_font_size(value=False)
    table.set_fontsize(11)
    for (_, column), cell in table.get_celld().items():
        cell.set_linewidth(0)
        cell.PAD = 0.03
        cell.set_text_props(**({"family": "monospace"} if column else {"ha": "left"}))
