"""Bars of the repetitions of each parameter: before reduction, of the model, and proved to be needed."""

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from mbdlft.base.errors import AnalysisError
from mbdlft.show.figures.figures import COLORS, WORST, check_figure, write_figure
from mbdlft.system.model import LFTModel, System

_WIDE, _NARROW = 0.8, 0.46  # heights of the bars
_BEFORE = "#d5d9e0"


def save_orders(path: str | Path, model: System) -> None:
    """Draw how often each parameter is repeated, beside what is proved of that.

    A wide gray bar is the number before reduction, a bar inside of it that of the model, and a line the
    lower bound: no exact LFT of the same system has fewer repetitions of this parameter.

    Parameters
    ----------
    path : file, whose ending is that of a figure, such as .png
    model : LFTModel

    Raises
    ------
    AnalysisError
        The file cannot be written, its ending is not that of a figure, or the model has no certificate or
        no parameters.
    """
    check_figure(path)
    if not isinstance(model, LFTModel):
        raise AnalysisError(
            f"model {model.name!r} is a system without evidence: nothing is known of its orders."
        )
    if not model.parameters:
        raise AnalysisError(
            f"model {model.name!r}: without parameters there are no orders to draw."
        )
    count = len(model.parameters)
    figure = Figure(figsize=(8.0, 1.7 + 0.3 * count), layout="constrained")
    _draw(figure.add_subplot(), model)
    figure.legend(loc="outside lower center", ncols=3, fontsize="small")
    write_figure(figure, path)


def _draw(axes: Axes, model: LFTModel) -> None:
    """The bars, the first parameter on top."""
    said, rows = model.certificate, np.arange(len(model.parameters))
    axes.barh(rows, said.raw_order, _WIDE, color=_BEFORE, label="before reduction")
    axes.barh(rows, said.order, _NARROW, color=COLORS[0], label="of the model")
    low, high = rows - 0.5 * _WIDE, rows + 0.5 * _WIDE
    axes.vlines(said.lower_bound, low, high, color=WORST, linewidth=2.0, label="proved lower bound")
    for row, (order, bound, raw) in enumerate(
        zip(said.order, said.lower_bound, said.raw_order, strict=True)
    ):
        text = f" {order}" if order == bound else f" {order}, at least {bound}"
        axes.text(max(order, raw), row, text, va="center", fontsize="small")
    axes.set_yticks(rows, [p.name for p in model.parameters])
    axes.invert_yaxis()
    axes.set_xlim(0.0, 1.15 * max(1, *said.raw_order, *said.order))
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.set_xlabel("repetitions")
    total = max(said.order_bound, sum(said.lower_bound))
    proved = "minimal: proved" if said.minimal else f"at least {total}: proved"
    if not said.exact:
        proved = "not exact; the bounds are those of exact models"
    axes.set_title(f"{model.name}: order {model.order}, {proved}")
    axes.grid(visible=True, axis="x", linewidth=0.3, alpha=0.5)
