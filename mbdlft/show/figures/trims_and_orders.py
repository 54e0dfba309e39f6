"""What a model has apart from its responses: repetitions of its parameters, and its equilibrium."""

import math
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from mbdlft.base.array import Array
from mbdlft.base.errors import AnalysisError
from mbdlft.base.samples import grid, random
from mbdlft.show.figures.figures import (
    COLORS,
    WORST,
    check_figure,
    check_parameter,
    draw_grid,
    write_figure,
)
from mbdlft.system.model import LFTModel, System
from mbdlft.system.sampled import trim_at

_WIDE, _NARROW = 0.8, 0.46  # heights of the bars
_BEFORE = "#d5d9e0"
_STEPS = 81  # values of the parameter
_OTHERS = 60  # random samples of the other parameters
_MOST = 12  # signals that one figure has room for
_STILL = 1e-9  # of the largest of its unit: what changes less is called constant


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
        raise AnalysisError(f"model {model.name!r}: without parameters there are no orders to draw.")
    write_figure(orders_figure(model), path)


def orders_figure(model: LFTModel) -> Figure:
    """The bars of `save_orders`, the first parameter on top."""
    c, rows = model.certificate, np.arange(len(model.parameters))
    figure = Figure(figsize=(8.0, 1.7 + 0.3 * len(rows)), layout="constrained")
    axes = figure.add_subplot()
    axes.barh(rows, c.raw_order, _WIDE, color=_BEFORE, label="before reduction")
    axes.barh(rows, c.order, _NARROW, color=COLORS[0], label="of the model")
    low, high = rows - 0.5 * _WIDE, rows + 0.5 * _WIDE
    axes.vlines(c.lower_bound, low, high, color=WORST, linewidth=2.0, label="proved lower bound")
    for row, order, bound, raw in zip(rows, c.order, c.lower_bound, c.raw_order, strict=True):
        text = f" {order}" if order == bound else f" {order}, at least {bound}"
        axes.text(max(order, raw), float(row), text, va="center", fontsize="small")
    axes.set_yticks(rows, [p.name for p in model.parameters])
    axes.invert_yaxis()
    axes.set_xlim(0.0, 1.15 * max(1, *c.raw_order, *c.order))
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    total = max(c.order_bound, sum(c.lower_bound))
    proved = "minimal: proved" if c.minimal else f"at least {total}: proved"
    if not c.exact:
        proved = "not exact; the bounds are those of exact models"
    axes.set(title=f"{model.name}: order {model.order}, {proved}", xlabel="repetitions")
    axes.grid(visible=True, axis="x", linewidth=0.3, alpha=0.5)
    figure.legend(loc="outside lower center", ncols=3, fontsize="small")
    return figure


class TrimCurves(NamedTuple):
    """Trimmed signals over one parameter, whose values (N,) are in its unit."""

    values: Array
    nominal: Array  # (N, nt), with the other parameters nominal
    low: Array  # (N, nt), the least and the largest over samples of the others
    high: Array


def save_trims(path: str | Path, model: System, parameter: str | None = None, seed: int = 0) -> None:
    """Draw the efforts and loads that hold the equilibrium over one parameter.

    A line has the other parameters nominal, the shade around it is what random samples of them reach:
    samples, and no bounds. Twelve signals have room: those that the parameters change most.

    Parameters
    ----------
    path : file, whose ending is that of a figure, such as .png
    model : LFTModel
    parameter : str, optional
        Its name; by default the one that changes the trim most, the others nominal.
    seed : int
        Seed of the samples.

    Raises
    ------
    AnalysisError
        The file cannot be written, its ending is not that of a figure, the model has no trim or no
        parameters, or the parameter is unknown.
    """
    check_figure(path)
    trimmed = _checked(model, parameter)
    name = parameter or _strongest(trimmed)
    curves = trim_curves(trimmed, name, seed)
    signals = trimmed.trim.signals
    largest = _sizes(trimmed, np.concatenate([curves.low, curves.high]))
    change = (np.max(curves.high, axis=0) - np.min(curves.low, axis=0)) / largest
    shown = sorted(sorted(range(len(signals)), key=lambda k: -change[k])[:_MOST])
    wide = min(3, len(shown))
    tall = math.ceil(len(shown) / wide)
    figure = Figure(figsize=(2.0 + 3.4 * wide, 1.2 + 2.5 * tall), layout="constrained")
    unit = trimmed.parameters[name].unit
    for place, k in enumerate(shown):
        axes = figure.add_subplot(tall, wide, place + 1)
        axes.fill_between(
            curves.values, curves.low[:, k], curves.high[:, k], color=COLORS[0], alpha=0.2, linewidth=0,
            label=f"{_OTHERS} samples of the other parameters" if len(trimmed.parameters) > 1 else "",
        )  # fmt: skip
        axes.plot(curves.values, curves.nominal[:, k], color=COLORS[0], label="others nominal")
        axes.axvline(trimmed.parameters[name].nominal, color="black", linewidth=0.6, linestyle=":")
        if change[k] < _STILL:  # rounding is not to be seen as a shape
            middle = float(curves.nominal[0, k])
            axes.set_ylim(middle - largest[k], middle + largest[k])
        axes.set(xlabel=f"{name} ({unit})", ylabel=f"{signals[k].name} ({signals[k].unit})")
        draw_grid(axes)
    more = f", {_MOST} of {len(signals)} signals" if len(signals) > _MOST else ""
    figure.suptitle(f"{model.name}: what holds the equilibrium, over {name}{more}")
    figure.legend(*axes.get_legend_handles_labels(), loc="outside lower center", ncols=2,
                  fontsize="small")  # fmt: skip
    write_figure(figure, path)


def trim_curves(model: LFTModel, parameter: str, seed: int = 0) -> TrimCurves:
    """Trimmed signals over one parameter, from its low to its high value."""
    along = grid(model.parameters, {parameter: _STEPS})[parameter]
    nominal = trim_at(model, {parameter: along})
    low, high = nominal.copy(), nominal.copy()
    others = [p for p in model.parameters if p.name != parameter]
    if others:
        drawn = random(others, _OTHERS, seed)
        spread = {name: np.repeat(values, _STEPS) for name, values in drawn.items()}
        spread[parameter] = np.tile(along, _OTHERS)
        sampled = trim_at(model, spread).reshape(_OTHERS, _STEPS, -1)
        low, high = np.minimum(low, sampled.min(axis=0)), np.maximum(high, sampled.max(axis=0))
    return TrimCurves(along, nominal, low, high)


def _checked(model: System, parameter: str | None) -> LFTModel:
    """The model, if it has what is to be drawn."""
    problem = ""
    if not isinstance(model, LFTModel) or not model.trim.signals:
        problem = "nothing holds its equilibrium, so there is no trim to draw"
    elif model.trim.lft is None:
        problem = "it was stored without the LFT of its trim"
    elif not model.parameters:
        problem = "without parameters the trim is one number each, which `mbdlft show` prints"
    if problem or not isinstance(model, LFTModel):
        raise AnalysisError(f"model {model.name!r}: {problem}.")
    check_parameter(model, parameter)
    return model


def _strongest(model: LFTModel) -> str:
    """The parameter whose range changes the trim most, relative to the largest of each unit."""
    changes = []
    for p in model.parameters:
        efforts = trim_at(model, grid(model.parameters, {p.name: 9}))
        changes.append(float(np.max(np.ptp(efforts, axis=0) / _sizes(model, efforts))))
    return model.parameters[int(np.argmax(changes))].name


def _sizes(model: LFTModel, efforts: Array) -> Array:
    """The largest size of all trimmed signals (N, nt) of the same unit, (nt,); 1 where all are zero."""
    size = np.abs(efforts).max(axis=0)
    units = np.array([signal.unit for signal in model.trim.signals])
    largest = np.array([size[units == unit].max() for unit in units])
    return np.where(largest > 0.0, largest, 1.0)
