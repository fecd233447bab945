"""A calibration's report as one picture, and its panels as SVG for the printable page.

All contents come from the result and the arrays in the calibration's HDF5 file.
"""

import textwrap
from base64 import b64encode
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure, FigureBase, SubFigure
from matplotlib.transforms import Bbox
from numpy.typing import NDArray

from sawmill_calibration.pictures.pages import LOG_WINDOW, Window, window_of
from sawmill_calibration.pictures.panels import (
    draw_frame_pairs,
    draw_log,
    draw_phantom,
    draw_residual,
    draw_search,
    draw_theta_and_twin,
    encoded,
    localise,
)
from sawmill_calibration.pictures.report_numbers import calibration_table
from sawmill_contracts.calibrations import CalibrationResult, FoundGeometry
from sawmill_mill.next_step import NextStep, step_alone
from sawmill_vocabulary import ReconstructionMethod
from sawmill_vocabulary.calibration_arrays import CalibrationArrays, LogImages
from sawmill_vocabulary.messages import ENGLISH, N_, Reader

WIDTH_IN = 14.0
LINE_IN = 0.27
COLUMNS = 150
ALARM = "#b71c1c"
GUESSED_EDGES = N_("The views do not go all round: edges along no ray are guessed.")
COLORS = {"good": "#2e7d32", "watch": "#b26a00", "bad": ALARM, "idle": "#555555"}


def report_png(
    result: CalibrationResult, arrays: CalibrationArrays, step: NextStep | None = None, reader: Reader = ENGLISH
) -> bytes:
    """Draw the report of a calibration as a PNG file; arguments and errors as for `report_figure`."""
    return encoded(report_figure(result, arrays, step or step_alone(result), reader))


def report_figure(
    result: CalibrationResult, arrays: CalibrationArrays, step: NextStep, reader: Reader = ENGLISH
) -> Figure:
    """Draw the report of a calibration, the next step at the top, or raise `ValueError` for other numbers of angles."""
    lines = list(_lines(result, step, reader))
    heights = {"head": 1.0 + LINE_IN * len(lines), "found": 6.1, "fit": 5.4, "pairs": 6.4}
    if arrays.log is not None:
        heights = {"head": heights["head"], "found": heights["found"], "log": 6.6, **heights}
    figure = Figure(figsize=(WIDTH_IN, sum(heights.values())), layout="constrained")
    grid = figure.add_gridspec(len(heights), 1, height_ratios=list(heights.values()))
    parts = {name: figure.add_subfigure(grid[row]) for row, name in enumerate(heights)}
    _draw_head(parts["head"], result.phantom, step, reader, lines, heights["head"])
    phantom_part, table_part = _side_by_side(parts["found"], 1, 1.02)
    title = reader.words(N_("The phantom with the geometry found, and its drawing's outline over it"))
    if arrays.phantom_image_method is ReconstructionMethod.TOTAL_VARIATION:
        title += "\n" + reader.words(GUESSED_EDGES)
    phantom_part.suptitle(title)
    _draw_outlined(phantom_part, arrays, reader)
    _draw_table(table_part.add_subplot(), calibration_table(result))
    if arrays.log is not None:
        _draw_logs(parts["log"], arrays.log, reader)
    residual_part, search_part = _side_by_side(parts["fit"], 1.9, 1)
    share = N_("RMS %(rms)s, %(share)s %% of the sinogram.")
    of_sinogram = {"rms": f"{result.residual.rms:.3g}", "share": f"{100 * result.residual.relative:.3g}"}
    title = f"{reader.words(N_('Residual: measured less model'))}: {reader.words(share) % of_sinogram}"
    residual_part.suptitle(reader.localised(title))
    _draw_residual(residual_part, result, arrays, reader)
    search, evaluations = result.search, reader.words(N_("evaluations"))
    search_part.suptitle(f"{reader.words(N_('Search'))}: {search.method}, {search.evaluations} {evaluations}")
    draw_search(search_part, arrays.search_history, result.residual.relative, reader)
    _draw_pairs(parts["pairs"], result, reader)
    localise(figure, reader)
    return figure


def report_panels(result: CalibrationResult, arrays: CalibrationArrays, reader: Reader = ENGLISH) -> dict[str, str]:
    """Draw the panels of the printable page as data URLs of SVG, by name: those of `report.html` that there are."""
    panels = {"residual": _svg(7.4, 3.4, reader, lambda figure: _draw_residual(figure, result, arrays, reader))}
    if arrays.phantom_image.any():
        panels["phantom"] = _svg(4.2, 3.6, reader, lambda figure: _draw_outlined(figure, arrays, reader))
    if len(arrays.search_history) > 1:
        history, final = arrays.search_history, result.residual.relative
        panels["search"] = _svg(3.7, 3.4, reader, lambda figure: draw_search(figure, history, final, reader))
    if (log := arrays.log) is not None:
        window = window_of(log.after, *LOG_WINDOW)
        for name, image in (("before", log.before), ("after", log.after)):
            if image is not None:
                panels[name] = _svg(3.6, 3.6, reader, partial(_draw_one_log, image, log.field_mm, window))
    return panels


def overlay_png(arrays: CalibrationArrays) -> bytes:
    """Draw only the phantom's reconstruction under its outlines; its only words are a warning of guessed edges."""
    figure = Figure(figsize=(9.0, 8.2), layout="constrained")
    if arrays.phantom_image_method is ReconstructionMethod.TOTAL_VARIATION:
        figure.suptitle(GUESSED_EDGES)
    _draw_outlined(figure, arrays, ENGLISH)
    return encoded(figure)


def _svg(width_in: float, height_in: float, reader: Reader, draw: Callable[[Figure], object]) -> str:
    figure = Figure(figsize=(width_in, height_in), layout="constrained")
    draw(figure)
    localise(figure, reader)
    return "data:image/svg+xml;base64," + b64encode(encoded(figure, "svg")).decode("ascii")


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
    top = 1 - 0.2 / height_in
    badge = {"boxstyle": "round,pad=0.45", "facecolor": COLORS[step.card_tone], "edgecolor": "none"}
    bold: dict[str, Any] = {"fontweight": "bold", "va": "top"}
    title, word = (
        reader.words(N_("Calibration with %(phantom)s")) % {"phantom": phantom},
        reader.words(step.word).upper(),
    )
    part.text(0.012, top, title, fontsize=19, **bold)
    part.text(0.985, top, word, fontsize=17, color="white", ha="right", bbox=badge, **bold)
    for number, (line, line_color) in enumerate(lines):
        part.text(0.012, 1 - (0.85 + LINE_IN * number) / height_in, line, fontsize=12.5, va="top", color=line_color)


def _draw_outlined(figure: FigureBase, arrays: CalibrationArrays, reader: Reader) -> None:
    image, field_mm, outlines = arrays.phantom_image, arrays.phantom_field_mm, arrays.phantom_outlines_mm
    draw_phantom(figure, figure.add_subplot(), image, field_mm, outlines, reader)


def _draw_logs(part: SubFigure, log: LogImages, reader: Reader) -> None:
    row = reader.words(N_("row %(row)s of this scan,")) % {"row": log.row}
    titles = (f"{row} {reader.words(log.before_with.phrase)}", reader.words(N_("The log with this calibration")))
    axes, window = part.subplots(1, 2), window_of(log.after, *LOG_WINDOW)
    for ax, title, image in zip(axes, titles, (log.before, log.after), strict=True):
        if image is None:
            ax.set_axis_off()
            missing = reader.words(N_("No geometry from before that shows it."))
            ax.text(0.5, 0.5, missing, transform=ax.transAxes, ha="center", fontsize=12)
            continue
        ax.set_title(title, fontsize=13)
        shown = draw_log(ax, image, log.field_mm, window)
    part.colorbar(shown, ax=axes, shrink=0.9, pad=0.015)


def _draw_one_log(image: NDArray[np.float32], field_mm: float, window: Window, figure: Figure) -> None:
    draw_log(figure.add_subplot(), image, field_mm, window)


def _draw_residual(figure: FigureBase, result: CalibrationResult, arrays: CalibrationArrays, reader: Reader) -> None:
    residual, angles_deg = arrays.residual, np.rad2deg(arrays.angles_rad)
    if len(angles_deg) != len(residual):
        raise ValueError(f"the residual {residual.shape} and {len(angles_deg)} angles do not agree")
    draw_residual(figure, residual, angles_deg, result.scanner.detector_pitch_mm, reader)


def _draw_pairs(part: SubFigure, geometry: FoundGeometry, reader: Reader) -> None:
    frame_part, theta_part = _side_by_side(part, 1.15, 1)
    covariance = np.zeros((5, 5)) if geometry.covariance is None else np.array(geometry.covariance)
    if np.count_nonzero(np.diag(covariance)) < 2:
        frame_part.suptitle(reader.words(N_("None: this method has no error bars.")))
    else:
        frame_part.suptitle(reader.words(N_("Source frame: ellipses that hold 95 of 100 answers")))
        draw_frame_pairs(frame_part, covariance)
    twin = "" if geometry.theta_twin is None else ": " + reader.words(N_("The twin gives the same sinogram."))
    theta_part.suptitle(f"Theta{twin}")
    draw_theta_and_twin(theta_part, geometry, reader)


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
