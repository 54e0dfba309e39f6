"""Poles in the complex plane: over one parameter, or of random samples."""

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from mbdlft.base.errors import AnalysisError, unknown_name
from mbdlft.base.samples import grid
from mbdlft.response.modes import poles
from mbdlft.show.figures.figures import (
    COLORS,
    SAMPLES,
    WORST,
    check_figure,
    drawn_samples,
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
