"""Poles in the complex plane: over one parameter, or of random samples.

How a worst case grows with the box of the parameters: bounds as steps.

The structured singular value over frequency: bounds that are proved on bands, as steps.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from mbdlft.base.array import Array
from mbdlft.base.errors import AnalysisError, unknown_name
from mbdlft.base.samples import grid
from mbdlft.lft.lft import LFT
from mbdlft.response.modes import poles
from mbdlft.robust.evidence import Bounds
from mbdlft.robust.gain import worst_case_gain
from mbdlft.robust.mu.singular_value import mu_bands
from mbdlft.robust.worst import worst_case
from mbdlft.show.figures.figures import (
    COLORS,
    SAMPLES,
    WORST,
    check_figure,
    drawn_samples,
    over_frequency,
    write_figure,
)
from mbdlft.system.model import System

_STEPS = 201  # values of a parameter
_ROOM = 0.08  # of the width and height, around the poles


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
    seed : int
        Seed of the samples.
    most_samples : int
        How many there are, at most.

    Raises
    ------
    AnalysisError
        The file cannot be written, its ending is not that of a figure, there are no states, or the
        parameter is unknown.
    """
    check_figure(path)
    if not model.states:
        raise AnalysisError(f"model {model.name!r}: without states there are no poles to draw.")
    if parameter is not None and parameter not in model.parameters.names:
        raise AnalysisError(
            f"model {model.name!r}: " + unknown_name("parameter", parameter, model.parameters.names)
        )
    figure = Figure(figsize=(8.0, 6.0), layout="constrained")
    axes = figure.add_subplot()
    nominal = poles(model)[0]
    title = "poles"
    found = nominal[None]
    if parameter is not None:
        values = grid(model.parameters, {parameter: _STEPS})
        found = poles(model, values)
        shade = np.repeat(values[parameter], found.shape[1])
        drawn = axes.scatter(
            found.real.ravel(), found.imag.ravel(), c=shade, s=9, cmap="viridis", linewidths=0
        )
        unit = model.parameters[parameter].unit
        figure.colorbar(drawn, label=f"{parameter} ({unit})")
        title = f"poles over {parameter}, the others nominal"
    elif model.parameters:
        values, count = drawn_samples(model, seed, most_samples)
        found = poles(model, values)
        axes.plot(
            found.real.ravel(), found.imag.ravel(), ".", color=COLORS[0], markersize=4.0, alpha=0.5,
            markeredgewidth=0.0, label=f"{count} samples",
        )  # fmt: skip
        title = "poles of samples"
    axes.plot(nominal.real, nominal.imag, "x", color="black", markersize=7.0, label="nominal")
    _frame(axes, np.concatenate([found.ravel(), nominal]))
    axes.set_title(f"{model.name}: {title}")
    figure.legend(loc="outside lower right", ncols=2, fontsize="small")
    write_figure(figure, path)


def _frame(axes: Axes, found: NDArray[np.complex128]) -> None:
    """Limits and labels; what is right of the imaginary axis is unstable, and shaded."""
    real, imaginary = found.real, found.imag
    size = float(np.max(np.abs(found))) or 1.0
    width = max(float(np.max(real) - min(np.min(real), 0.0)), 1e-3 * size)
    height = max(float(np.max(np.abs(imaginary))), 0.1 * width)
    left = min(float(np.min(real)), 0.0) - _ROOM * width
    right = max(float(np.max(real)), 0.0) + _ROOM * width
    axes.set(xlim=(left, right), ylim=(-(1.0 + _ROOM) * height, (1.0 + _ROOM) * height))
    axes.axvspan(0.0, right, color=WORST, alpha=0.08, linewidth=0.0)
    axes.axvline(0.0, color="black", linewidth=0.8)
    axes.axhline(0.0, color="black", linewidth=0.4)
    axes.set_xlabel("real part (rad/s)")
    axes.set_ylabel("imaginary part (rad/s)")
    axes.grid(visible=True, linewidth=0.3, alpha=0.5)


_SIZES = 12
_DECADE = 10.0  # a larger range of values is drawn in logarithms
_IS_LOWER = ("smallest damping", "smallest disk margin")  # what is proved is the lower bound


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

    Raises
    ------
    AnalysisError
        The file cannot be written, its ending is not that of a figure, sizes do not rise from above 0, or
        as `worst_case`.
    """
    check_figure(path)
    end = 0.98 * margin.lower if margin is not None and margin.lower > 0.0 else 1.0
    given = np.linspace(0.0, end, _SIZES + 1)[1:] if sizes is None else np.array(sizes, dtype=float)
    if not len(given) or not (given[0] > 0.0 and np.all(np.diff(given) > 0.0)):
        raise AnalysisError(f"save_growth: expected sizes that rise from above 0, got {sizes!r}.")
    asked: dict[str, Any] = {"gap": gap, "work": work, "leave_out": leave_out}
    found = []
    for size in given:
        box = _of_size(model, float(size))
        if what == "gain":
            found.append(worst_case_gain(box, inputs, outputs, **asked))
        else:
            found.append(worst_case(box, what, inputs, outputs, **asked))
    is_lower = found[0].kind in _IS_LOWER
    proved = np.array([each.lower if is_lower else each.upper for each in found])
    reached = np.array([each.upper if is_lower else each.lower for each in found])
    _draw(path, model, found[0].kind, given, proved, reached, margin)


def _of_size(model: System, size: float) -> System:
    """The system whose deltas are these over a size."""
    lft = model.lft
    scaled = LFT(size * lft.M11, size * lft.M12, lft.M21, lft.M22, lft.blocks)
    name = f"{model.name}, {size:.4g} times the box"
    return System(name, scaled, model.states, model.inputs, model.outputs, model.parameters)


def _draw(
    path: str | Path,
    model: System,
    kind: str,
    sizes: Array,
    proved: Array,
    reached: Array,
    margin: Bounds | None,
) -> None:
    figure = Figure(figsize=(8.0, 5.0), layout="constrained")
    axes = figure.add_subplot()
    edges = np.append(0.0, sizes)
    shown = np.where(np.isfinite(proved), proved, np.nan)
    axes.stairs(shown, edges, baseline=None, color=COLORS[0], linewidth=1.4, label="proved")
    reached = np.where(np.isfinite(reached), reached, np.nan)
    axes.step(sizes, reached, ".-", where="post", color=COLORS[1], linewidth=1.0, label="reached")
    if margin is not None:
        for value, style, label in (
            (margin.lower, "--", f"margin, proved: {margin.lower:.4g}"),
            (margin.upper, ":", f"margin, worst case: {margin.upper:.4g}"),
        ):
            if np.isfinite(value):
                axes.axvline(value, color=WORST, linestyle=style, linewidth=1.0, label=label)
    axes.axvline(1.0, color="black", linewidth=0.6)
    known = np.concatenate([shown, reached])
    known = known[np.isfinite(known)]
    if len(known) and np.min(known) > 0.0 and np.max(known) > _DECADE * np.min(known):
        axes.set_yscale("log")
    axes.set_xlabel("size of the box (times the declared ranges)")
    axes.set_ylabel(kind)
    axes.set_title(f"{model.name}: {len(model.parameters)} parameters, order {model.order}")
    axes.grid(visible=True, linewidth=0.3, alpha=0.5)
    axes.legend(fontsize="small")
    write_figure(figure, path)


_DECADES = 1.5  # beyond the poles


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

    Raises
    ------
    AnalysisError
        The file cannot be written, its ending is not that of a figure, or as `mu_bands`.
    """
    check_figure(path)
    sizes = np.abs(np.linalg.eigvals(model.A)) if len(model.A) else np.ones(1)
    sizes = sizes[sizes > 0.0] if np.any(sizes) else np.ones(1)
    ends = np.array([np.min(sizes), np.max(sizes)]) * 10.0 ** np.array([-_DECADES, _DECADES])
    low, high = (float(end) for end in ends)
    found = mu_bands(model, low, high, gap=gap, leave_out=leave_out)
    figure = Figure(figsize=(8.0, 5.0), layout="constrained")
    axes = figure.add_subplot()
    top = np.where(np.isfinite(found.upper), found.upper, np.nan)
    label = f"D and G on {len(top)} bands: proved for all frequencies in them"
    axes.stairs(top, found.edges, baseline=None, color=COLORS[0], linewidth=1.4, label=label)
    seen = found.lower > 0.0
    if np.any(seen):
        axes.plot(
            found.at[seen], found.lower[seen], ".", color=COLORS[2], markersize=4.0,
            label="reached at one frequency",
        )  # fmt: skip
    if margin is not None and margin.lower > 0.0:
        label = f"proved for all: {1.0 / margin.lower:.4g}, margin {margin.lower:.4g}"
        axes.axhline(1.0 / margin.lower, color=WORST, linestyle="--", linewidth=1.0, label=label)
    if margin is not None and np.isfinite(margin.upper) and margin.upper > 0.0:
        label = f"worst case: {1.0 / margin.upper:.4g} at {margin.frequency:.4g} rad/s"
        at = min(max(margin.frequency, low), high)
        axes.plot([at], [1.0 / margin.upper], "o", color=WORST, markersize=5.0, label=label)
    over_frequency(axes, low, high)
    axes.set_ylim(bottom=0.0)
    axes.set_xlabel("frequency (rad/s)")
    axes.set_ylabel("structured singular value")
    axes.set_title(f"{model.name}: {len(model.parameters)} parameters, order {model.order}")
    axes.grid(visible=True, which="both", linewidth=0.3, alpha=0.5)
    axes.legend(fontsize="small")
    write_figure(figure, path)
