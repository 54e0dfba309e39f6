"""What all figures share: the file, panels and their labels, colors, decibels, samples that are drawn."""

import logging
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from io import BytesIO
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.text import Text
from numpy.typing import NDArray

from mbdlft.archive.archive import put, target_of
from mbdlft.base.array import Array, ArrayLike
from mbdlft.base.errors import AnalysisError, ArchiveError, check_known
from mbdlft.base.samples import random
from mbdlft.response.frequency import response_frequencies, unbounded_frequencies
from mbdlft.response.modes import Names, chosen
from mbdlft.system.model import System

Lines = Literal["major", "minor", "both"]  # of a grid
SAMPLES = 300  # of random values: lines of a cloud that the eye can still tell apart
COLORS = ("#4477aa", "#cc6677", "#228833", "#aa7711", "#66ccee", "#aa3377")
WORST = "#d62728"
_WORK = 4e9  # products that the responses of all samples may take
_EACH = 500  # frequencies of a sample, about
_IN_A_DECADE, _EVENLY = 100, (100, 500)  # evenly spaced frequencies; all of them, by pixels
_SUPERSCRIPTS = str.maketrans(
    "-0123456789", "\u207b\u2070\u00b9\u00b2\u00b3\u2074\u2075\u2076\u2077\u2078\u2079"
)
_DOTS = 150  # in an inch
_FLOOR = 160.0  # dB below the highest value: what is lower, such as a zero, is cut
_ROOM = 0.04  # of the height of the axes, above and below the curves
_WIDTH: ContextVar[float | None] = ContextVar("width", default=None)  # cm, of figures for a paper
_INCH, _WIDTHS = 2.54, (5.0, 60.0)  # cm
_ONE_COLUMN = 12.0  # cm: a narrower figure has one column of panels, and of its legend
_HEIGHT = 0.8  # power of the share of the width, as letters do not become smaller
_PAPER: dict[Any, Any] = {
    "font.size": 8.0,
    "axes.titlesize": "medium",
    "figure.titlesize": "medium",
    "pdf.fonttype": 42,
}
# the glyphs that a font does not have are those of the next one
_LATEX: dict[Any, Any] = {
    "font.family": ["cmr10", "STIXGeneral", "DejaVu Sans"], "mathtext.fontset": "cm",
    "axes.formatter.use_mathtext": True, "axes.unicode_minus": False,
}  # fmt: skip


@contextmanager
def for_paper(width: float = 8.5, *, fonts: Literal["sans", "latex"] = "sans") -> Iterator[None]:
    """Figures that are drawn inside have a width for print, and letters of 8 points.

    Parameters
    ----------
    width : float, cm, from 5 to 60
        Such as 8.5 for one column and 17 for two; the height follows.
    fonts : {"sans", "latex"}
        Computer Modern for "latex". A file .pgf has the fonts of the document, where LaTeX is installed.
    """
    if not _WIDTHS[0] <= width <= _WIDTHS[1]:
        raise AnalysisError(f"a width of {width:g} cm: expected {_WIDTHS[0]:g} to {_WIDTHS[1]:g} cm.")
    before = _WIDTH.set(width)
    logging.getLogger("fontTools").setLevel(logging.ERROR)  # fonts of matplotlib have odd dates
    try:
        with rc_context({**_PAPER, **(_LATEX if fonts == "latex" else {})}):
            yield
    finally:
        _WIDTH.reset(before)


def check_figure(path: str | Path) -> None:
    """Raise an AnalysisError, before the work, for a missing folder or an ending not of a figure."""
    file, endings = Path(path), Figure().canvas.get_supported_filetypes()
    problem = ""
    if not file.parent.is_dir():
        problem = f"{file.parent} is not a folder."
    elif file.suffix[1:].lower() not in endings:
        known = ", ".join(sorted(endings))
        problem = f"expected the ending {known}, got {file.suffix!r}."
    if problem:
        raise AnalysisError(f"{file}: the figure cannot be written: {problem}")


def check_parameter(model: System, parameter: str | None) -> None:
    """Raise an AnalysisError for the name of a parameter that a model does not have."""
    if parameter is not None:
        check_known(
            "parameter", [parameter], model.parameters.names, f"model {model.name!r}", AnalysisError
        )


def write_figure(figure: Figure, path: str | Path) -> None:
    """Write a figure into a file, beside an old one first; names of a user are shown as they are."""
    file = Path(path)
    figure.set_dpi(_DOTS)
    if (width := _WIDTH.get()) is not None:
        before, height = figure.get_size_inches()
        share = (width / _INCH / before) ** _HEIGHT
        # panels of a narrow figure keep their shape above their legends
        legends = sum(legend.get_window_extent().height / figure.dpi for legend in figure.legends)
        figure.set_size_inches(width / _INCH, height * share + legends)
    _show_dollars(figure)
    engine, image = figure.get_layout_engine(), BytesIO()
    try:
        if engine is not None:  # once, instead of a drawing that nobody sees
            engine.execute(figure)
            figure.set_layout_engine("none")
        ending = file.suffix[1:] or figure.canvas.get_default_filetype()
        figure.savefig(image, dpi=_DOTS, format=ending)
        file = target_of(file if file.suffix else Path(f"{file}.{ending}"))
        put({file: image.getvalue()})
    except (OSError, ValueError, ArchiveError) as error:
        reason = str(error).removeprefix(f"{file}: cannot be written: ").rstrip(".")
        raise AnalysisError(f"{path}: the figure cannot be written: {reason}.") from None


def add_legend(axes: Axes, *, columns: int = 2, where: str = "lower center") -> None:
    """A legend beside the panels; one of a narrow figure is below them, in one column."""
    width, figure = _WIDTH.get(), axes.get_figure(root=True)
    if width is not None and width < _ONE_COLUMN:
        columns, where = 1, "lower center"
    place: Any = f"outside {where}"
    assert figure is not None
    figure.legend(*axes.get_legend_handles_labels(), loc=place, ncols=columns, fontsize="small")


def panel_columns(most: int) -> int:
    """Columns of panels that a figure has room for."""
    width = _WIDTH.get()
    return 1 if width is not None and width < _ONE_COLUMN else most


def _show_dollars(figure: Figure) -> None:
    """Titles, labels and legends have names of a user, whose dollars are no mathematics."""
    texts: list[Text] = [*figure.texts]
    for axes in figure.axes:
        texts += [axes.title, axes.xaxis.label, axes.yaxis.label, *axes.texts]
    for legend in (*(axes.get_legend() for axes in figure.axes), *figure.legends):
        texts += legend.get_texts() if legend is not None else []
    for text in texts:
        text.set_parse_math(False)


def panel(
    title: str, x: str, y: str = "", size: tuple[float, float] = (8.0, 5.0), which: Lines = "major"
) -> tuple[Figure, Axes]:
    """A figure with one panel, its title and the labels of its axes; `which` lines its grid has."""
    figure = Figure(figsize=size, layout="constrained")
    axes = figure.add_subplot()
    axes.set(title=title, xlabel=x, ylabel=y)
    draw_grid(axes, which)
    return figure, axes


def draw_grid(axes: Axes, which: Lines = "major") -> None:
    """Thin lines behind the curves."""
    axes.grid(visible=True, which=which, linewidth=0.3, alpha=0.5)


def facts(model: System) -> str:
    """Name, order and number of parameters of a model, as a title."""
    return f"{model.name}: order {model.order}, parameters: {len(model.parameters)}"


class Channels(NamedTuple):
    """Panels of the channels that a figure shows."""

    figure: Figure
    rows: list[int]  # numbers of the outputs in the model
    columns: list[int]  # and of the inputs
    axes: NDArray[Any]  # (outputs, panels of a channel, inputs)

    def finish(self, model: System, count: int, x: str) -> None:
        """Label the horizontal axes and the whole figure, which shows `count` samples."""
        for axes in self.axes[-1, -1]:
            axes.set_xlabel(x)
        add_legend(self.axes[0, 0, 0], columns=3, where="lower right")
        self.figure.suptitle(f"{model.name}: nominal" + (f" and {count} samples" if count else ""))


def channel_panels(
    model: System, outputs: Names, inputs: Names, most: int, height: float, ratios: Sequence[int] = (1,)
) -> Channels:
    """Panels for each channel, `height` (inches) in all, one below the other; all without names.

    There is an AnalysisError for more than `most` channels, for none, and for unknown names.
    """
    rows = chosen(model.name, "output", outputs, model.outputs, "channels to draw")
    columns = chosen(model.name, "input", inputs, model.inputs, "channels to draw")
    if len(rows) * len(columns) > most:
        raise AnalysisError(
            f"model {model.name!r}: {len(rows)} x {len(columns)} channels are more than the {most} that "
            "a figure has room for. Choose some outputs and inputs."
        )
    size = (max(6.0, 4.2 * len(columns)), 1.0 + height * len(rows))
    figure = Figure(figsize=size, layout="constrained")
    panels = figure.subplots(
        len(ratios) * len(rows), len(columns), sharex=True, squeeze=False,
        height_ratios=[*ratios] * len(rows),
    )  # fmt: skip
    shape = (len(rows), len(ratios), len(columns))
    return Channels(figure, rows, columns, panels.reshape(shape))


def drawn_samples(system: System, seed: int, most: int = SAMPLES) -> tuple[dict[str, Array], int]:
    """Random samples, and how many: `most`, or fewer of a large model; none without parameters."""
    each = _EACH * max(1.0, float(len(system.states)) ** 2 * max(1, len(system.inputs)))
    count = int(max(min(20, most), min(most, _WORK / each))) if system.parameters else 0
    return (random(system.parameters, count, seed) if count else {}), count


def draw_cloud(axes: Axes, x: Array, curves: Array, color: str, alpha: float, label: str) -> None:
    """Thin lines of samples over x, both (N, F), with a thick one in the legend."""
    lines = [np.column_stack(pair) for pair in zip(x, curves, strict=True)]
    axes.add_collection(LineCollection(lines, colors=color, linewidths=0.5, alpha=alpha))
    axes.plot([], [], color=color, linewidth=2.0, alpha=0.5, label=label)


def drawn_frequencies(
    system: System, values: Mapping[str, ArrayLike] | None = None, ends: tuple[float, float] | None = None
) -> Array:
    """Frequencies (N, F) of a figure, rad/s: as `response_frequencies`, as many in each decade."""
    low, high = ends or response_frequencies(system, values, None, None, 2)[0, [0, -1]].tolist()
    points = int(np.clip(_IN_A_DECADE * np.log10(high / low), *_EVENLY))
    return response_frequencies(system, values, low, high, points)


def decibels(values: Array) -> Array:
    """20 log10 of values, elementwise."""
    return 20.0 * np.log10(np.maximum(values, np.finfo(float).tiny))


def set_heights(axes: Axes, values: Array) -> None:
    """Limits of a vertical axis in dB: all of the curves, but no more than 160 dB of them."""
    finite = values[np.isfinite(values)]
    if not finite.size:
        return
    top = float(np.max(finite))
    bottom = max(float(np.min(finite)), top - _FLOOR)
    room = max(_ROOM * (top - bottom), 1.0)
    axes.set_ylim(bottom - room, top + room)


def over_frequency(axes: Axes, first: float, last: float) -> None:
    """A logarithmic axis of frequencies, with powers of ten as plain text, which is drawn faster.

    An axis of less than two decades has the labels of matplotlib, also between powers of ten.
    """
    axes.set(xscale="log", xlim=(first, last))
    if last >= 100.0 * first:
        axes.xaxis.set_major_formatter(lambda omega, _: _power(omega))


def _power(value: float) -> str:
    """A power of ten as plain text."""
    exponent = f"{np.log10(value):.0f}" if value > 0.0 else ""
    return "10" + exponent.translate(_SUPERSCRIPTS)


def mark_unbounded(axes: Axes, system: System) -> None:
    """Lines at the frequencies, but zero, at which the nominal response is infinite."""
    (unbounded,) = unbounded_frequencies(system)
    first, last = axes.get_xlim()
    for k, omega in enumerate(unbounded[(first < unbounded) & (unbounded < last)]):
        label = "" if k else "unbounded at nominal: pole without damping"
        axes.axvline(omega, color="black", linewidth=0.9, linestyle=":", label=label)
