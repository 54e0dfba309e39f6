"""Poles in the complex plane, and what is proved of them and of gains: bounds drawn as steps.

A bound of a worst case that is proved for a box holds for every smaller box; a bound of the structured
singular value is proved on a band of frequencies.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from mbdlft.base.array import Array
from mbdlft.base.errors import AnalysisError
from mbdlft.base.samples import grid
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
    check_figure,
    check_parameter,
    draw_grid,
    drawn_samples,
    facts,
    over_frequency,
    panel,
    write_figure,
)
from mbdlft.system.model import System

_STEPS = 201  # values of a parameter
_ROOM = 0.08  # of the width and height, around the poles
_SIZES = 12  # boxes, by default: each is a search of its own
_DECADE = 10.0  # a larger range of values is drawn in logarithms
_IS_LOWER = ("smallest damping", "smallest disk margin")  # what is proved is the lower bound
_DECADES = 1.5  # beyond the poles


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

    Raises
    ------
    AnalysisError
        The file cannot be written, its ending is not that of a figure, there are no states, or the
        parameter is unknown.
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
    figure.legend(loc="outside lower right", ncols=2, fontsize="small")
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
    axes.legend(fontsize="small")
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
    axes.legend(fontsize="small")
    write_figure(figure, path)
