"""Bode diagrams, one for each channel: size and phase of the nominal model over those of samples.

The cloud of singular values: the nominal model, samples, and the worst of them.

Step responses, one panel for each channel.
"""

from collections.abc import Iterable, Mapping
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from numpy.typing import NDArray

from mbdlft.base.array import Array
from mbdlft.base.errors import AnalysisError
from mbdlft.response.frequency import (
    frequency_response,
    gain_unit,
    peaks,
    singular_values,
    unbounded_frequencies,
)
from mbdlft.response.modes import Names
from mbdlft.response.time import response_times, step_response
from mbdlft.show.figures.figures import (
    COLORS,
    SAMPLES,
    WORST,
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


_MOST_INSIDE = 4  # most singular values whose legend has room inside the axes


def save_singular_values(
    path: str | Path,
    model: System,
    seed: int = 0,
    *,
    most_samples: int = SAMPLES,
    worst: Mapping[str, float] | None = None,
    bound: float | None = None,
) -> None:
    """Draw the singular values of the nominal model and of random samples.

    Every sample has its own frequencies, around its poles, so that its peaks are right to 0.1 dB. Where
    the nominal response is infinite, there is a dotted line.

    Parameters
    ----------
    path : file, whose ending is that of a figure, such as .png
    model : System or LFTModel
    seed : int
        Seed of the samples.
    most_samples : int
        How many there are, at most.
    worst : mapping of names to physical values, optional
        A worst case to draw, that is known from elsewhere; by default the sample of the highest peak.
    bound : float, optional
        A guaranteed bound of the gain over the whole range, in its unit, to draw as a line.

    Raises
    ------
    AnalysisError
        The file cannot be written, its ending is not that of a figure, or there is nothing to draw.
    """
    check_figure(path)
    if not (model.inputs and model.outputs):
        raise AnalysisError(
            f"model {model.name!r}: without inputs or outputs there are no singular values to draw. "
            "Choose some in [linearize]."
        )
    values, count = drawn_samples(model, seed, most_samples)
    chosen = values if count else {}
    omega = drawn_frequencies(model, chosen)
    samples = decibels(singular_values(frequency_response(model, chosen, omega)))
    first, last = float(omega[0, 0]), float(omega[0, -1])
    at_nominal = drawn_frequencies(model, {}, (first, last))
    nominal = decibels(singular_values(frequency_response(model, {}, at_nominal)))
    figure = Figure(
        figsize=(8.0 if nominal.shape[2] <= _MOST_INSIDE else 10.0, 5.0), layout="constrained"
    )
    axes = figure.add_subplot()
    over_frequency(axes, first, last)
    if count:
        _draw_cloud(axes, omega, samples)
    for k in range(nominal.shape[2]):  # singular values are sorted, so these curves do not cross
        label = "" if k else "nominal"
        axes.plot(at_nominal[0], nominal[0, :, k], color="black", linewidth=1.2, label=label)
    if worst is not None:
        at_worst = drawn_frequencies(model, worst, (first, last))
        highest = decibels(singular_values(frequency_response(model, worst, at_worst)))
        _draw_worst(axes, at_worst[0], highest[0, :, 0], "worst case", model, worst)
    elif count:
        k = int(np.argmax(np.max(peaks(samples[:, :, 0]), axis=1)))
        sample = {name: float(column[k]) for name, column in values.items()}
        what = "sample of the highest peak"
        _draw_worst(axes, omega[k], samples[k, :, 0], what, model, sample)
    heights = [samples.ravel(), nominal.ravel()]
    if bound is not None:
        heights.append(decibels(np.array([bound])))
        label = f"guaranteed bound: {heights[-1][0]:.2f} dB"
        axes.axhline(heights[-1][0], color=WORST, linestyle="--", label=label)
    mark_unbounded(axes, model)
    _finish(figure, axes, model, np.concatenate(heights))
    write_figure(figure, path)


def _draw_cloud(axes: Axes, omega: Array, samples: Array) -> None:
    """Thin lines of all samples (N, F, k) in dB over their frequencies (N, F)."""
    for k in range(samples.shape[2]):
        color, label = COLORS[k % len(COLORS)], f"singular value {k + 1}, {len(omega)} samples"
        lines = [np.column_stack(each) for each in zip(omega, samples[:, :, k], strict=True)]
        axes.add_collection(LineCollection(lines, colors=color, linewidths=0.5, alpha=0.15))
        axes.plot([], [], color=color, linewidth=2.0, alpha=0.5, label=label)


def _draw_worst(
    axes: Axes,
    omega: Array,
    values: Array,
    what: str,
    model: System,
    at: Mapping[str, float],
) -> None:
    """The largest singular value of one sample, and where it has its peak."""
    k = int(np.argmax(peaks(values[None])[0]))
    label = f"{what}: {values[k]:.1f} dB at {omega[k]:.4g} rad/s"
    (infinite,) = unbounded_frequencies(model, at)
    infinite = infinite[(infinite > omega[0]) & (infinite < omega[-1])]
    if len(infinite):
        nearest = infinite[np.argmin(np.abs(infinite - omega[k]))]
        label = f"{what}: unbounded at {nearest:.4g} rad/s"
    axes.plot(omega, values, color=WORST, linewidth=1.0, label=label)


def _finish(figure: Figure, axes: Axes, model: System, values: Array) -> None:
    """Labels, limits and the legend."""
    axes.set_xlabel("frequency (rad/s)")
    axes.set_ylabel(f"singular values (dB of {gain_unit(model)})")
    axes.set_title(f"{model.name}: {len(model.parameters)} parameters, order {model.order}")
    axes.grid(visible=True, which="both", linewidth=0.3, alpha=0.5)
    set_heights(axes, values)
    inside = min(len(model.inputs), len(model.outputs)) <= _MOST_INSIDE
    if inside:
        axes.legend(loc="lower left", fontsize="small")
    else:
        figure.legend(loc="outside right upper", fontsize="small")


_MOST_PANELS = 25  # channels that one figure has room for


def save_step(
    path: str | Path,
    model: System,
    seed: int = 0,
    *,
    outputs: Names = None,
    inputs: Names = None,
) -> None:
    """Draw step responses of each channel, the nominal model over random samples.

    Parameters
    ----------
    path : file, whose ending is that of a figure, such as .png
    model : System or LFTModel
    seed : int
        Seed of the samples.
    outputs, inputs : names of channels; all by default

    Raises
    ------
    AnalysisError
        The file cannot be written, its ending is not that of a figure, there is nothing to draw, there
        are more than 25 channels, or a name is unknown.
    """
    check_figure(path)
    rows, columns = drawn_channels(model, outputs, inputs, _MOST_PANELS)
    values, count = drawn_samples(model, seed)
    names = {
        "outputs": [model.outputs[k].name for k in rows],
        "inputs": [model.inputs[k].name for k in columns],
    }
    times = response_times(model, values if count else {})
    nominal = step_response(model, {}, times, **names).values[0]
    samples = step_response(model, values, times, **names).values if count else nominal[None]
    figure = Figure(
        figsize=(max(6.0, 4.2 * len(columns)), 1.0 + 2.4 * len(rows)), layout="constrained"
    )
    panels = figure.subplots(len(rows), len(columns), sharex=True, squeeze=False)
    for i, row in enumerate(rows):
        for k, column in enumerate(columns):
            axes = panels[i, k]
            if count:
                low, high = (f(samples[:, :, i, k], axis=0) for f in (np.min, np.max))
                axes.fill_between(
                    times, low, high, color=COLORS[0], alpha=0.3, linewidth=0.0,
                    label="from the lowest to the highest sample",
                )  # fmt: skip
            axes.plot(times, nominal[:, i, k], color="black", linewidth=1.2, label="nominal")
            output, step = model.outputs[row], model.inputs[column]
            axes.set_title(f"step of {step.name} to {output.name}", fontsize="medium")
            axes.set_ylabel(f"{output.unit} / ({step.unit})", fontsize="small")
            axes.set_xlim(0.0, times[-1])
            axes.grid(visible=True, linewidth=0.3, alpha=0.5)
            axes.autoscale_view(scalex=False)
    for axes in panels[-1]:
        axes.set_xlabel("time (s)")
    handles, labels = panels[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower right", ncols=2, fontsize="small")
    figure.suptitle(f"{model.name}: nominal" + (f" and {count} samples" if count else ""))
    write_figure(figure, path)
