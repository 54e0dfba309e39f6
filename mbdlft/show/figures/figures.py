"""What all figures share: the file, colors, decibels, samples that are drawn."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.text import Text

from mbdlft.base.array import Array, ArrayLike
from mbdlft.base.errors import AnalysisError
from mbdlft.base.samples import random
from mbdlft.response.frequency import response_frequencies, unbounded_frequencies
from mbdlft.response.modes import Names, chosen
from mbdlft.system.model import System

SAMPLES = 300
COLORS = ("#4477aa", "#cc6677", "#228833", "#aa7711", "#66ccee", "#aa3377")
WORST = "#d62728"
_WORK = 4e9  # products that the responses of all samples may take
_EACH = 500  # frequencies of a sample, about
_IN_A_DECADE, _EVENLY = (
    100,
    (100, 500),
)  # frequencies that are evenly spaced; all of them, in pixels
_RAISED = str.maketrans(
    "-0123456789", "\u207b\u2070\u00b9\u00b2\u00b3\u2074\u2075\u2076\u2077\u2078\u2079"
)
_DOTS = 150  # in an inch
_FLOOR = 160.0  # dB below the highest value: what is lower is cut
_ROOM = 0.04  # of the height of the axes, above and below the curves


def check_figure(path: str | Path) -> None:
    """Raise an error if it is known before the work that a figure cannot be written here.

    Raises
    ------
    AnalysisError
        Its folder does not exist, or its ending is not that of a figure.
    """
    file, endings = Path(path), Figure().canvas.get_supported_filetypes()
    problem = ""
    if not file.parent.is_dir():
        problem = f"{file.parent} is not a folder."
    elif file.suffix[1:].lower() not in endings:
        known = ", ".join(sorted(endings))
        problem = f"expected the ending {known}, got {file.suffix!r}."
    if problem:
        raise AnalysisError(f"{file}: the figure cannot be written: {problem}")


def write_figure(figure: Figure, path: str | Path) -> None:
    """Write a figure into a file.

    Raises
    ------
    AnalysisError
        The file cannot be written.
    """
    figure.set_dpi(_DOTS)
    _as_they_are(figure)
    engine = figure.get_layout_engine()
    try:
        if engine is not None:  # once, instead of a drawing that nobody sees
            engine.execute(figure)
            figure.set_layout_engine("none")
        figure.savefig(path, dpi=_DOTS)
    except (OSError, ValueError) as error:
        raise AnalysisError(f"{path}: the figure cannot be written: {error}.") from None


def _as_they_are(figure: Figure) -> None:
    """Titles, labels and legends have names of a user, whose dollars are no mathematics."""
    texts: list[Text] = []
    for axes in figure.axes:
        texts += [axes.title, axes.xaxis.label, axes.yaxis.label, *axes.texts]
    legends = [axes.get_legend() for axes in figure.axes]
    for legend in (*legends, *figure.legends):
        texts += legend.get_texts() if legend is not None else []
    for text in (*texts, *figure.texts):
        text.set_parse_math(False)


def drawn_channels(
    model: System, outputs: Names, inputs: Names, most: int
) -> tuple[list[int], list[int]]:
    """Numbers of the outputs and inputs of these names, all without names.

    Raises
    ------
    AnalysisError
        There is nothing to draw, there are more than `most` channels, or a name is unknown.
    """
    rows = chosen(model.name, "output", outputs, model.outputs, "channels to draw")
    columns = chosen(model.name, "input", inputs, model.inputs, "channels to draw")
    if len(rows) * len(columns) > most:
        raise AnalysisError(
            f"model {model.name!r}: {len(rows)} x {len(columns)} channels are more than the {most} that "
            "a figure has room for. Choose some outputs and inputs."
        )
    return rows, columns


def drawn_samples(system: System, seed: int, most: int = SAMPLES) -> tuple[dict[str, Array], int]:
    """Random samples, and how many: `most`, or fewer of a large model; none without parameters."""
    each = _EACH * max(1.0, float(len(system.states)) ** 2 * max(1, len(system.inputs)))
    count = int(max(min(20, most), min(most, _WORK / each))) if system.parameters else 0
    return random(system.parameters, count, seed), count


def drawn_frequencies(
    system: System,
    values: Mapping[str, ArrayLike] | None = None,
    ends: tuple[float, float] | None = None,
) -> Array:
    """Frequencies (N, F) of a figure, rad/s: as `response_frequencies`, as many in each decade."""
    low, high = ends or (None, None)
    two = response_frequencies(system, values, low, high, 2)
    decades = float(np.log10(two[0, -1] / two[0, 0]))
    points = int(np.clip(_IN_A_DECADE * decades, *_EVENLY))
    return response_frequencies(system, values, float(two[0, 0]), float(two[0, -1]), points)


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
    """A logarithmic axis of frequencies; its powers of ten are plain text, which is drawn soon.

    An axis of less than two decades has the labels of matplotlib, also between powers of ten.
    """
    axes.set(xscale="log", xlim=(first, last))
    if last >= 100.0 * first:
        axes.xaxis.set_major_formatter(lambda value, _: _power(value))


def _power(value: float) -> str:
    """A power of ten with a raised exponent, as text."""
    exponent = f"{np.log10(value):.0f}" if value > 0.0 else ""
    return "10" + exponent.translate(_RAISED)


def mark_unbounded(axes: Axes, system: System) -> None:
    """Lines at the frequencies, but zero, at which the nominal response is infinite."""
    (found,) = unbounded_frequencies(system)
    first, last = axes.get_xlim()
    shown = [omega for omega in found if first < omega < last]
    for k, omega in enumerate(shown):
        label = "" if k else "unbounded at nominal: pole without damping"
        axes.axvline(omega, color="black", linewidth=0.9, linestyle=":", label=label)
