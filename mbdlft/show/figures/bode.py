"""Bode diagrams, one for each channel: size and phase of the nominal model over those of samples."""

from collections.abc import Iterable
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from numpy.typing import NDArray

from mbdlft.base.array import Array
from mbdlft.response.frequency import frequency_response
from mbdlft.response.modes import Names
from mbdlft.show.figures.figures import (
    COLORS,
    SAMPLES,
    check_figure,
    decibels,
    drawn_channels,
    drawn_frequencies,
    drawn_samples,
    mark_unbounded,
    over_frequency,
    set_heights,
    write_figure,
)
from mbdlft.system.model import System

Complex = NDArray[np.complex128]
Cloud = tuple[Array, Complex]  # frequencies (N, F), values (N, F)
_MOST = 16  # channels that one figure has room for
_RIGHT_ANGLE = 90.0  # deg


def save_bode(
    path: str | Path,
    model: System,
    seed: int = 0,
    *,
    most_samples: int = SAMPLES,
    outputs: Names = None,
    inputs: Names = None,
) -> None:
    """Draw size and phase of each channel, the nominal model over random samples.

    Parameters
    ----------
    path : file, whose ending is that of a figure, such as .png
    model : System or LFTModel
    seed : int
        Seed of the samples.
    most_samples : int
        How many there are, at most.
    outputs, inputs : names of channels; all by default

    Raises
    ------
    AnalysisError
        The file cannot be written, its ending is not that of a figure, there is nothing to draw, there
        are more than 16 channels, or a name is unknown.
    """
    check_figure(path)
    rows, columns = drawn_channels(model, outputs, inputs, _MOST)
    values, count = drawn_samples(model, seed, most_samples)
    picked = values if count else {}
    omega = drawn_frequencies(model, picked)
    samples = frequency_response(model, picked, omega)
    at_nominal = drawn_frequencies(model, {}, (float(omega[0, 0]), float(omega[0, -1])))
    nominal = frequency_response(model, {}, at_nominal)
    figure = Figure(
        figsize=(max(6.0, 4.2 * len(columns)), 1.0 + 3.6 * len(rows)), layout="constrained"
    )
    panels = figure.subplots(
        2 * len(rows), len(columns), sharex=True, squeeze=False, height_ratios=[2, 1] * len(rows)
    )
    for i, row in enumerate(rows):
        for k, column in enumerate(columns):
            pair = panels[2 * i : 2 * i + 2, k]
            clouds = (omega, samples[:, :, row, column]), (at_nominal, nominal[:, :, row, column])
            _draw_channel(pair, clouds, many=bool(count))
            gain, phase = model.outputs[row], model.inputs[column]
            pair[0].set_title(f"{phase.name} to {gain.name}", fontsize="medium")
            pair[0].set_ylabel(f"size (dB of {gain.unit} / ({phase.unit}))", fontsize="small")
            pair[1].set_ylabel("phase (deg)", fontsize="small")
            mark_unbounded(pair[0], model[[gain.name], [phase.name]])
    for axes in panels[-1]:
        axes.set_xlabel("frequency (rad/s)")
    handles, labels = panels[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower right", ncols=3, fontsize="small")
    figure.suptitle(f"{model.name}: nominal" + (f" and {count} samples" if count else ""))
    write_figure(figure, path)


def _draw_channel(pair: Iterable[Axes], clouds: tuple[Cloud, Cloud], *, many: bool) -> None:
    """Size and phase of one channel: of samples, and of the nominal model."""
    for kind, axes in zip((_size, _phase), pair, strict=True):
        (omega, samples), (at_nominal, nominal) = clouds
        curves = kind(samples)
        if many:
            lines = [np.column_stack(each) for each in zip(omega, curves, strict=True)]
            axes.add_collection(LineCollection(lines, colors=COLORS[0], linewidths=0.5, alpha=0.2))
            axes.plot([], [], color=COLORS[0], linewidth=2.0, alpha=0.5, label="samples")
        middle = kind(nominal)[0]
        axes.plot(at_nominal[0], middle, color="black", linewidth=1.2, label="nominal")
        over_frequency(axes, float(at_nominal[0, 0]), float(at_nominal[0, -1]))
        axes.grid(visible=True, which="both", linewidth=0.3, alpha=0.5)
        if kind is _size:
            set_heights(axes, np.concatenate([curves.ravel(), middle]))
        else:
            axes.set_ylim(-2.1 * _RIGHT_ANGLE, 2.1 * _RIGHT_ANGLE)
            axes.set_yticks(np.arange(-2, 3) * _RIGHT_ANGLE)


def _size(values: Complex) -> Array:
    return decibels(np.abs(values))


def _phase(values: Complex) -> Array:
    """Phases in (-180, 180] deg; where they wrap, a gap instead of a line from top to bottom."""
    phases = np.degrees(np.angle(values))
    jumps = np.abs(np.diff(phases, axis=1, prepend=phases[:, :1])) > 2.0 * _RIGHT_ANGLE
    return np.where(jumps, np.nan, phases)
