"""What a model has apart from its responses: poles, bounds that are proved, repetitions, its equilibrium.

A bound of a worst case that is proved for a box holds for every smaller box, so it is drawn as steps; a
bound of the structured singular value is proved on a band of frequencies.
"""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from mbdlft.base.arguments import arguments_checked
from mbdlft.base.array import Array
from mbdlft.base.errors import AnalysisError
from mbdlft.base.samples import grid, random
from mbdlft.exact.rounding import eigenvalues_of
from mbdlft.lft.lft import LFT
from mbdlft.response.modes import poles
from mbdlft.robust.evidence import Bounds
from mbdlft.robust.gain import worst_case_gain
from mbdlft.robust.mu.singular_value import mu_bands
from mbdlft.robust.proofs import verify
from mbdlft.robust.worst import worst_case
from mbdlft.show.figures.figures import (
    COLORS,
    SAMPLES,
    WORST,
    add_legend,
    check_figure,
    check_parameter,
    draw_grid,
    drawn_samples,
    facts,
    over_frequency,
    panel,
    panel_columns,
    write_figure,
)
from mbdlft.system.model import LFTModel, System
from mbdlft.system.sampled import trim_at

_STEPS = 201  # values of a parameter
_ROOM = 0.08  # of the width and height, around the poles
_SIZES = 12  # boxes, by default: each is a search of its own
_DECADE = 10.0  # a larger range of values is drawn in logarithms
_IS_LOWER = ("smallest damping", "smallest disk margin")  # what is proved is the lower bound
_DECADES = 1.5  # beyond the poles


@arguments_checked
def save_pole_map(
    path: str | Path,
    model: System,
    parameter: str | None = None,
    seed: int = 0,
    most_samples: int = SAMPLES,
) -> None:
    """Draw poles over a parameter, the others nominal, or those of random samples.

    Parameters
    ----------
    path : file, whose ending is that of a figure, such as .png
    model : System or LFTModel
    parameter : str, optional
        Its name; the color of a pole is its value. Without it: random samples of all parameters.
    seed, most_samples : int
        Seed of the random samples, and how many there are at most.
    """
    check_figure(path)
    if not model.states:
        raise AnalysisError(f"model {model.name!r}: without states there are no poles to draw.")
    check_parameter(model, parameter)
    labels = "real part (rad/s)", "imaginary part (rad/s)"
    figure, axes = panel(f"{model.name}: poles", *labels, (8.0, 6.0))
    nominal = poles(model)[0]
    drawn = nominal[None]
    if parameter is not None:
        values = grid(model.parameters, {parameter: _STEPS})
        drawn = poles(model, values)
        shade = np.repeat(values[parameter], drawn.shape[1])
        dots = axes.scatter(
            drawn.real.ravel(), drawn.imag.ravel(), c=shade, s=9, cmap="viridis", linewidths=0
        )
        figure.colorbar(dots, label=f"{parameter} ({model.parameters[parameter].unit})")
        axes.set_title(f"{model.name}: poles over {parameter}, the others nominal")
    elif model.parameters:
        values, count = drawn_samples(model, seed, most_samples)
        drawn = poles(model, values)
        axes.plot(
            drawn.real.ravel(), drawn.imag.ravel(), ".", color=COLORS[0], markersize=4.0, alpha=0.5,
            markeredgewidth=0.0, label=f"{count} samples",
        )  # fmt: skip
        axes.set_title(f"{model.name}: poles of samples")
    axes.plot(nominal.real, nominal.imag, "x", color="black", markersize=7.0, label="nominal")
    _frame(axes, np.concatenate([drawn.ravel(), nominal]))
    add_legend(axes, where="lower right")
    write_figure(figure, path)


def _frame(axes: Axes, drawn: NDArray[np.complex128]) -> None:
    """Limits around the poles; what is right of the imaginary axis is unstable, and shaded."""
    real, imaginary = drawn.real, drawn.imag
    size = float(np.max(np.abs(drawn))) or 1.0
    width = max(float(np.max(real) - min(np.min(real), 0.0)), 1e-3 * size)
    height = max(float(np.max(np.abs(imaginary))), 0.1 * width)
    left = min(float(np.min(real)), 0.0) - _ROOM * width
    right = max(float(np.max(real)), 0.0) + _ROOM * width
    axes.set(xlim=(left, right), ylim=(-(1.0 + _ROOM) * height, (1.0 + _ROOM) * height))
    axes.axvspan(0.0, right, color=WORST, alpha=0.08, linewidth=0.0)
    axes.axvline(0.0, color="black", linewidth=0.8)
    axes.axhline(0.0, color="black", linewidth=0.4)


@arguments_checked
def save_growth(
    path: str | Path,
    model: System,
    what: str = "gain",
    inputs: Any = slice(None),
    outputs: Any = slice(None),
    *,
    sizes: Sequence[float] | None = None,
    margin: Bounds | None = None,
    gap: float = 0.02,
    work: float = 10.0,
    leave_out: Sequence[str] = (),
) -> None:
    """Draw the worst case over boxes of growing size.

    What is proved for a box holds for all smaller ones, and what is reached in it for all larger ones: so
    bounds are steps, and true between the sizes, too.

    Parameters
    ----------
    path : file, whose ending is that of a figure, such as .png
    model : System or LFTModel
    what : {"gain", "real part", "damping", "disk margin"}
    inputs, outputs : signals of the transfer, as for `worst_case_gain`
    sizes : sequence of float, rising, optional
        Multiples of the declared ranges; 12 up to 1, or up to the margin, by default.
    margin : Bounds, optional
        Of `robust_stability`, drawn as lines.
    gap, work, leave_out
        As for `worst_case_gain`, for each size.
    """
    check_figure(path)
    end = 0.98 * margin.lower if margin is not None and margin.lower > 0.0 else 1.0
    scales = np.linspace(0.0, end, _SIZES + 1)[1:] if sizes is None else np.array(sizes, float)
    if not len(scales) or not (scales[0] > 0.0 and np.all(np.diff(scales) > 0.0)):
        raise AnalysisError(f"save_growth: expected sizes that rise from above 0, got {sizes!r}.")
    search: dict[str, Any] = {"gap": gap, "work": work, "leave_out": leave_out}
    bounds = []
    for scale in scales:
        box = _scaled(model, float(scale))
        if what == "gain":
            bounds.append(worst_case_gain(box, inputs, outputs, **search))
        else:
            bounds.append(worst_case(box, what, inputs, outputs, **search))
    kind = bounds[0].kind
    upper, lower = (_finite([getattr(b, end) for b in bounds]) for end in ("upper", "lower"))
    proved, reached = (lower, upper) if kind in _IS_LOWER else (upper, lower)
    figure, axes = panel(facts(model), "size of the box (times the declared ranges)", kind)
    axes.stairs(
        proved, np.append(0.0, scales), baseline=None, color=COLORS[0], linewidth=1.4, label="proved"
    )
    axes.step(scales, reached, ".-", where="post", color=COLORS[1], linewidth=1.0, label="reached")
    if margin is not None:
        for value, style, label in (
            (margin.lower, "--", f"margin, {_word(model, margin)}: {margin.lower:.4g}"),
            (margin.upper, ":", f"margin, worst case: {margin.upper:.4g}"),
        ):
            if np.isfinite(value):
                axes.axvline(value, color=WORST, linestyle=style, linewidth=1.0, label=label)
    axes.axvline(1.0, color="black", linewidth=0.6)
    values = np.concatenate([proved, reached])
    values = values[np.isfinite(values)]
    if len(values) and np.min(values) > 0.0 and np.max(values) > _DECADE * np.min(values):
        axes.set_yscale("log")
        draw_grid(axes)
    add_legend(axes)
    write_figure(figure, path)


def _scaled(model: System, size: float) -> System:
    """The system over the box of `size` times its ranges: each delta is multiplied by the size."""
    lft = model.lft
    scaled = LFT(size * lft.M11, size * lft.M12, lft.M21, lft.M22, lft.blocks)
    name = f"{model.name}, {size:.4g} times the box"
    return System(name, scaled, model.states, model.inputs, model.outputs, model.parameters)


def _word(model: System, margin: Bounds) -> str:
    return "not proved" if verify(model, margin) else "proved"


def _finite(values: Sequence[float] | Array) -> Array:
    """Values, with nan, which is not drawn, for what is infinite."""
    return np.where(np.isfinite(values), values, np.nan)


@arguments_checked
def save_mu(
    path: str | Path,
    model: System,
    margin: Bounds | None = None,
    *,
    gap: float = 0.1,
    leave_out: Sequence[str] = (),
) -> None:
    """Draw bounds of mu over frequency: steps that are proved, and lower bounds in each band.

    Parameters
    ----------
    path : file, whose ending is that of a figure, such as .png
    model : System or LFTModel
    margin : Bounds, optional
        Of `robust_stability`: 1/lower is drawn as what is proved for all frequencies, 1/upper as what is
        reached.
    gap, leave_out
        As for `mu_bands`.
    """
    check_figure(path)
    sizes = np.abs(eigenvalues_of(model.A)) if len(model.A) else np.ones(1)
    sizes = sizes[sizes > 0.0] if np.any(sizes) else np.ones(1)
    ends = np.array([np.min(sizes), np.max(sizes)]) * 10.0 ** np.array([-_DECADES, _DECADES])
    low, high = (float(end) for end in ends)
    mu = mu_bands(model, low, high, gap=gap, leave_out=leave_out)
    labels = "frequency (rad/s)", "structured singular value"
    figure, axes = panel(facts(model), *labels, which="both")
    upper = _finite(mu.upper)
    label = f"D and G on {len(upper)} bands: proved for all frequencies in them"
    axes.stairs(upper, mu.edges, baseline=None, color=COLORS[0], linewidth=1.4, label=label)
    positive = mu.lower > 0.0
    if np.any(positive):
        axes.plot(
            mu.at[positive], mu.lower[positive], ".", color=COLORS[2], markersize=4.0,
            label="reached at one frequency",
        )  # fmt: skip
    if margin is not None and margin.lower > 0.0:
        label = f"{_word(model, margin)} for all: {1.0 / margin.lower:.4g}, margin {margin.lower:.4g}"
        axes.axhline(1.0 / margin.lower, color=WORST, linestyle="--", linewidth=1.0, label=label)
    if margin is not None and np.isfinite(margin.upper) and margin.upper > 0.0:
        label = f"worst case: {1.0 / margin.upper:.4g} at {margin.frequency:.4g} rad/s"
        at = min(max(margin.frequency, low), high)
        axes.plot([at], [1.0 / margin.upper], "o", color=WORST, markersize=5.0, label=label)
    over_frequency(axes, low, high)
    axes.set_ylim(bottom=0.0)
    add_legend(axes)
    write_figure(figure, path)


_WIDE, _NARROW = 0.8, 0.46  # heights of the bars
_BEFORE = "#d5d9e0"
_TRIM_STEPS = 81  # values of the parameter
_OTHERS = 60  # random samples of the other parameters
_MOST = 12  # signals that one figure has room for
_STILL = 1e-9  # of the largest of its unit: what changes less is called constant


@arguments_checked
def save_orders(path: str | Path, model: System) -> None:
    """Draw how often each parameter is repeated, beside what is proved of that.

    A wide gray bar is the number before reduction, a bar inside of it that of the model, and a line the
    lower bound: no exact LFT of the same system has fewer repetitions of this parameter.

    Parameters
    ----------
    path : file, whose ending is that of a figure, such as .png
    model : LFTModel
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
    for row, order, bound in zip(rows, c.order, c.lower_bound, strict=True):
        text = f" {order}" if order == bound else f" {order}, at least {bound}"
        axes.text(max(order, bound), float(row), text, va="center", fontsize="small")
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
    add_legend(axes, columns=3)
    return figure


class TrimCurves(NamedTuple):
    """Trimmed signals over one parameter, whose values (N,) are in its unit."""

    values: Array
    nominal: Array  # (N, nt), with the other parameters nominal
    low: Array  # (N, nt), the least and the largest over samples of the others
    high: Array


@arguments_checked
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
    """
    check_figure(path)
    trimmed = _checked(model, parameter)
    name = parameter or _strongest(trimmed)
    curves = trim_curves(trimmed, name, seed)
    signals = trimmed.trim.signals
    largest = _sizes(trimmed, np.concatenate([curves.low, curves.high]))
    change = (np.max(curves.high, axis=0) - np.min(curves.low, axis=0)) / largest
    shown = sorted(sorted(range(len(signals)), key=lambda k: -change[k])[:_MOST])
    wide = panel_columns(min(3, len(shown)))
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
    add_legend(axes)
    write_figure(figure, path)


def trim_curves(model: LFTModel, parameter: str, seed: int = 0) -> TrimCurves:
    """Trimmed signals over one parameter, from its low to its high value."""
    along = grid(model.parameters, {parameter: _TRIM_STEPS})[parameter]
    nominal = trim_at(model, {parameter: along})
    low, high = nominal.copy(), nominal.copy()
    others = [p for p in model.parameters if p.name != parameter]
    if others:
        drawn = random(others, _OTHERS, seed)
        spread = {name: np.repeat(values, _TRIM_STEPS) for name, values in drawn.items()}
        spread[parameter] = np.tile(along, _OTHERS)
        sampled = trim_at(model, spread).reshape(_OTHERS, _TRIM_STEPS, -1)
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
