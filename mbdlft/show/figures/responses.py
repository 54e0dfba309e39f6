"""Responses over frequency and time: the nominal model over random samples of its parameters.

A Bode diagram and a step response have a panel for each channel; singular values have one panel, with the
worst case beside the cloud of the samples.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from mbdlft.base.array import Array
from mbdlft.base.errors import AnalysisError
from mbdlft.base.unit import Signal
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
    channel_panels,
    check_figure,
    decibels,
    draw_cloud,
    draw_grid,
    drawn_frequencies,
    drawn_samples,
    facts,
    mark_unbounded,
    over_frequency,
    panel,
    set_heights,
    write_figure,
)
from mbdlft.system.model import System

Complex = NDArray[np.complex128]
_MOST_BODE, _MOST_STEPS = 16, 25  # channels that one figure has room for
_MOST_BELOW = 4  # singular values whose legend has room below the axes
_RIGHT_ANGLE = 90.0  # deg


class _Responses(NamedTuple):
    """Responses (N, F, outputs, inputs) of samples and of the nominal model; frequencies (N, F)."""

    values: dict[str, Array]
    drawn: int
    omega: Array
    samples: Complex
    at_nominal: Array
    nominal: Complex

    @property
    def ends(self) -> tuple[float, float]:
        """Lowest and highest frequency (rad/s)."""
        return float(self.omega[0, 0]), float(self.omega[0, -1])


def _responses(model: System, seed: int, most_samples: int) -> _Responses:
    """Responses of the nominal model and of random samples, each over its own frequencies."""
    values, count = drawn_samples(model, seed, most_samples)
    omega = drawn_frequencies(model, values)
    at_nominal = drawn_frequencies(model, {}, (float(omega[0, 0]), float(omega[0, -1])))
    samples, nominal = (
        frequency_response(model, at, over) for at, over in ((values, omega), ({}, at_nominal))
    )
    return _Responses(values, count, omega, samples, at_nominal, nominal)


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
    seed, most_samples : int
        Seed of the random samples, and how many there are at most.
    outputs, inputs : names of channels; all by default

    Raises
    ------
    AnalysisError
        The file cannot be written, its ending is not that of a figure, there is nothing to draw, there
        are more than 16 channels, or a name is unknown.
    """
    check_figure(path)
    channels = channel_panels(model, outputs, inputs, _MOST_BODE, 3.6, (2, 1))
    r = _responses(model, seed, most_samples)
    for i, row in enumerate(channels.rows):
        for k, column in enumerate(channels.columns):
            size, phase = channels.axes[i, :, k]
            for axes, kind in ((size, _size), (phase, _phase)):
                curves, middle = (kind(r.samples[:, :, row, column]), kind(r.nominal[:, :, row, column]))
                if r.drawn:
                    draw_cloud(axes, r.omega, curves, COLORS[0], 0.2, "samples")
                axes.plot(r.at_nominal[0], middle[0], color="black", linewidth=1.2, label="nominal")
                over_frequency(axes, *r.ends)
                draw_grid(axes, "both")
                if axes is size:
                    set_heights(axes, np.concatenate([curves.ravel(), middle[0]]))
            phase.set_ylim(-2.1 * _RIGHT_ANGLE, 2.1 * _RIGHT_ANGLE)
            phase.set_yticks(np.arange(-2, 3) * _RIGHT_ANGLE)
            output, source = model.outputs[row], model.inputs[column]
            size.set_title(f"{source.name} to {output.name}", fontsize="medium")
            size.set_ylabel(f"size (dB of {output.unit} / ({source.unit}))", fontsize="small")
            phase.set_ylabel("phase (deg)", fontsize="small")
            mark_unbounded(size, model[[output.name], [source.name]])
    channels.finish(model, r.drawn, "frequency (rad/s)")
    write_figure(channels.figure, path)


def _size(values: Complex) -> Array:
    return decibels(np.abs(values))


def _phase(values: Complex) -> Array:
    """Phases in (-180, 180] deg; where they wrap, a gap instead of a line from top to bottom."""
    phases = np.degrees(np.angle(values))
    jumps = np.abs(np.diff(phases, axis=1, prepend=phases[:, :1])) > 2.0 * _RIGHT_ANGLE
    return np.where(jumps, np.nan, phases)


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
    seed, most_samples : int
        Seed of the random samples, and how many there are at most.
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
    r = _responses(model, seed, most_samples)
    samples, nominal = (decibels(singular_values(values)) for values in (r.samples, r.nominal))
    inside = nominal.shape[2] <= _MOST_BELOW
    unit = f"singular values (dB of {gain_unit(model)})"
    size = (8.0 if inside else 10.0, 5.0)
    figure, axes = panel(facts(model), "frequency (rad/s)", unit, size, "both")
    over_frequency(axes, *r.ends)
    for k in range(samples.shape[2] if r.drawn else 0):
        label = f"singular value {k + 1}, {r.drawn} samples"
        draw_cloud(axes, r.omega, samples[:, :, k], COLORS[k % len(COLORS)], 0.15, label)
    for k in range(nominal.shape[2]):  # singular values are sorted, so these curves do not cross
        label = "" if k else "nominal"
        axes.plot(r.at_nominal[0], nominal[0, :, k], color="black", linewidth=1.2, label=label)
    if worst is not None:
        at_worst = drawn_frequencies(model, worst, r.ends)
        highest = decibels(singular_values(frequency_response(model, worst, at_worst)))
        _draw_worst(axes, at_worst[0], highest[0, :, 0], "worst case", model, worst)
    elif r.drawn:
        k = int(np.argmax(np.max(peaks(samples[:, :, 0]), axis=1)))
        sample = {name: float(column[k]) for name, column in r.values.items()}
        what = "sample of the highest peak"
        _draw_worst(axes, r.omega[k], samples[k, :, 0], what, model, sample)
    heights = [samples.ravel(), nominal.ravel()]
    if bound is not None:
        heights.append(decibels(np.array([bound])))
        label = f"guaranteed bound: {heights[-1][0]:.2f} dB"
        axes.axhline(heights[-1][0], color=WORST, linestyle="--", label=label)
    mark_unbounded(axes, model)
    set_heights(axes, np.concatenate(heights))
    if inside:
        figure.legend(loc="outside lower center", ncols=2, fontsize="small")
    else:
        figure.legend(loc="outside right upper", fontsize="small")
    write_figure(figure, path)


def _draw_worst(
    axes: Axes, omega: Array, values: Array, what: str, model: System, at: Mapping[str, float]
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


def save_step(
    path: str | Path, model: System, seed: int = 0, *, outputs: Names = None, inputs: Names = None
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
    channels = channel_panels(model, outputs, inputs, _MOST_STEPS, 2.4)
    values, count = drawn_samples(model, seed)
    names = {
        "outputs": [model.outputs[k].name for k in channels.rows],
        "inputs": [model.inputs[k].name for k in channels.columns],
    }
    times = response_times(model, values)
    nominal = step_response(model, {}, times, **names).values[0]
    samples = step_response(model, values, times, **names).values if count else nominal[None]
    for i, row in enumerate(channels.rows):
        for k, column in enumerate(channels.columns):
            axes = channels.axes[i, 0, k]
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
            draw_grid(axes)
            axes.autoscale_view(scalex=False)
    channels.finish(model, count, "time (s)")
    write_figure(channels.figure, path)


def save_motions(
    path: str | Path, name: str, times: Array, outputs: Sequence[Signal], runs: Mapping[str, Array]
) -> None:
    """Draw outputs over time, one panel for each, with the curves of some runs.

    Parameters
    ----------
    path : file, whose ending is that of a figure, such as .png
    name : of what moves
    times : array (N,), s
    outputs : sequence of n Signal
    runs : mapping of labels to arrays (N, n)
        The second, fourth, ... is drawn with dashes, in the color of the one before it.

    Raises
    ------
    AnalysisError
        The file cannot be written, its ending is not that of a figure, or there are no outputs, or more
        than 25.
    """
    check_figure(path)
    if not 0 < len(outputs) <= _MOST_STEPS:
        raise AnalysisError(f"{name}: {len(outputs)} outputs; expected 1 to {_MOST_STEPS} to draw.")
    columns = 1 if len(outputs) < 4 else 2
    rows = -(-len(outputs) // columns)
    figure = Figure(figsize=(5.0 * columns + 1.0, 1.0 + 2.0 * rows), layout="constrained")
    panels = figure.subplots(rows, columns, sharex=True, squeeze=False)
    for k, signal in enumerate(outputs):
        axes = panels[k // columns, k % columns]
        for number, (label, values) in enumerate(runs.items()):
            color, style = COLORS[number // 2 % len(COLORS)], "--" if number % 2 else "-"
            axes.plot(times, values[:, k], style, color=color, linewidth=1.2, label=label)
        axes.set_ylabel(f"{signal.name} ({signal.unit})", fontsize="small")
        draw_grid(axes)
    for axes in panels.ravel()[len(outputs) :]:
        axes.set_visible(False)
    for axes in panels[-1]:
        axes.set_xlabel("time (s)")
    handles, labels = panels[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower right", ncols=3, fontsize="small")
    figure.suptitle(name)
    write_figure(figure, path)
