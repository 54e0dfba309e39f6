"""Responses over frequency and time: the nominal model over random samples of its parameters.

A Bode diagram and a step response have a panel for each channel; singular values have one panel, with the
worst case beside the cloud of the samples.
"""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MultipleLocator
from numpy.typing import NDArray

from mbdlft.base.arguments import arguments_checked
from mbdlft.base.array import Array
from mbdlft.base.errors import AnalysisError
from mbdlft.base.unit import Signal
from mbdlft.response import frequency
from mbdlft.response.modes import Names
from mbdlft.response.time import response_times, step_response
from mbdlft.show.figures.figures import (
    COLORS,
    SAMPLES,
    WORST,
    add_legend,
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
    panel_columns,
    set_heights,
    write_figure,
)
from mbdlft.system.model import System
from mbdlft.system.sampled import matrices_at

Complex = NDArray[np.complex128]
_MOST_BODE, _MOST_STEPS = 16, 25  # channels that one figure has room for
_MOST_BELOW = 4  # singular values whose legend has room below the axes
_RIGHT_ANGLE = 90.0  # deg
_NYQUIST = 5.0  # the largest size that is seen, where the critical point is at 1
_PEAKS = (3.0, 6.0)  # dB, of the closed loop


class _Responses(NamedTuple):
    """Responses (N, F, outputs, inputs) of samples and of the nominal model; frequencies (N, F)."""

    values: dict[str, Array]
    drawn: int
    omega: Array
    samples: Complex
    at_nominal: Array
    nominal: Complex
    at_worst: Array
    worst: Complex | None  # without one, no frequencies

    @property
    def ends(self) -> tuple[float, float]:
        """Lowest and highest frequency (rad/s)."""
        return float(self.omega[0, 0]), float(self.omega[0, -1])

    def channel(self, row: int, column: int) -> "_Responses":
        """Those of one channel, (N, F)."""
        samples, nominal = (values[:, :, row, column] for values in (self.samples, self.nominal))
        worst = None if self.worst is None else self.worst[:, :, row, column]
        return self._replace(samples=samples, nominal=nominal, worst=worst)

    @property
    def every(self) -> list[Complex]:
        """All that there are."""
        return [self.samples, self.nominal, *([] if self.worst is None else [self.worst])]


def _responses(
    model: System, seed: int, most_samples: int, worst: Mapping[str, float] | None
) -> _Responses:
    """Responses of the nominal model, of random samples and a worst case, each over own frequencies."""
    values, count = drawn_samples(model, seed, most_samples)
    omega = drawn_frequencies(model, values)
    ends = float(omega[0, 0]), float(omega[0, -1])
    at_nominal = drawn_frequencies(model, {}, ends)
    samples, nominal = (
        frequency.frequency_response(model, at, over) for at, over in ((values, omega), ({}, at_nominal))
    )
    if worst is None:
        return _Responses(values, count, omega, samples, at_nominal, nominal, omega[:0], None)
    at_worst = drawn_frequencies(model, worst, ends)
    of_worst = frequency.frequency_response(model, worst, at_worst)
    return _Responses(values, count, omega, samples, at_nominal, nominal, at_worst, of_worst)


@arguments_checked
def save_bode(
    path: str | Path,
    model: System,
    seed: int = 0,
    *,
    most_samples: int = SAMPLES,
    outputs: Names = None,
    inputs: Names = None,
    worst: Mapping[str, float] | None = None,
) -> None:
    """Draw size and phase of each channel, the nominal model over random samples.

    Parameters
    ----------
    path : file, whose ending is that of a figure, such as .png
    model : System or LFTModel
    seed, most_samples : int
        Seed of the random samples, and how many there are at most.
    outputs, inputs : names of channels, up to 16; all by default
    worst : mapping of names to physical values, optional
        A worst case to draw, such as `Bounds.worst`.
    """
    options: dict[str, Any] = {"most_samples": most_samples, "worst": worst, "ratios": (2, 1)}
    options |= {"outputs": outputs, "inputs": inputs, "height": 3.6}
    _save_channels(path, model, seed, _bode, "frequency (rad/s)", **options)


def _bode(model: System, panels: NDArray[Any], r: _Responses, output: Signal, source: Signal) -> None:
    size, phase = panels
    for axes, kind in ((size, _size), (phase, _phase)):
        if r.drawn:
            draw_cloud(axes, r.omega, kind(r.samples), COLORS[0], 0.2, "samples")
        axes.plot(r.at_nominal[0], kind(r.nominal)[0], color="black", linewidth=1.2, label="nominal")
        if r.worst is not None:
            axes.plot(r.at_worst[0], kind(r.worst)[0], color=WORST, linewidth=1.0, label="worst case")
        over_frequency(axes, *r.ends)
        draw_grid(axes, "both")
    set_heights(size, np.concatenate([_size(values).ravel() for values in (r.samples, r.nominal)]))
    phase.set_ylim(-2.1 * _RIGHT_ANGLE, 2.1 * _RIGHT_ANGLE)
    phase.set_yticks(np.arange(-2, 3) * _RIGHT_ANGLE)
    size.set_ylabel(f"size (dB of {output.unit} / ({source.unit}))", fontsize="small")
    phase.set_ylabel("phase (deg)", fontsize="small")
    mark_unbounded(size, model[[output.name], [source.name]])


def _size(values: Complex) -> Array:
    return decibels(np.abs(values))


def _phase(values: Complex) -> Array:
    """Phases in (-180, 180] deg; where they wrap, a gap instead of a line from top to bottom."""
    phases = np.degrees(np.angle(values))
    jumps = np.abs(np.diff(phases, axis=1, prepend=phases[:, :1])) > 2.0 * _RIGHT_ANGLE
    return np.where(jumps, np.nan, phases)


@arguments_checked
def save_nyquist(path: str | Path, model: System, seed: int = 0, **options: Any) -> None:
    """Draw each channel as a curve of its complex values, the nominal model over random samples.

    The critical point is that of u = -y.

    Parameters
    ----------
    path, model, seed, **options
        As for `save_bode`, with its keywords most_samples, outputs, inputs, worst.
    """
    _save_channels(path, model, seed, _nyquist, "real part", **options)


@arguments_checked
def save_nichols(path: str | Path, model: System, seed: int = 0, **options: Any) -> None:
    """Draw size over phase of each channel, the nominal model over random samples.

    Dotted lines are where the loop of u = -y has |L/(1 + L)| of 3 and 6 dB.

    Parameters
    ----------
    path, model, seed, **options
        As for `save_bode`, with its keywords most_samples, outputs, inputs, worst.
    """
    _save_channels(path, model, seed, _nichols, "phase (deg)", **options)


def _save_channels(
    path: str | Path,
    model: System,
    seed: int,
    draw: Callable[[System, NDArray[Any], _Responses, Signal, Signal], None],
    x: str,
    *,
    height: float = 4.0,
    ratios: Sequence[int] = (1,),
    most_samples: int = SAMPLES,
    outputs: Names = None,
    inputs: Names = None,
    worst: Mapping[str, float] | None = None,
) -> None:
    """A figure with what `draw` draws into the panels of each channel."""
    check_figure(path)
    channels = channel_panels(model, outputs, inputs, _MOST_BODE, height, ratios)
    responses = _responses(model, seed, most_samples, worst)
    for i, row in enumerate(channels.rows):
        for k, column in enumerate(channels.columns):
            panels, output, source = channels.axes[i, :, k], model.outputs[row], model.inputs[column]
            draw(model, panels, responses.channel(row, column), output, source)
            panels[0].set_title(f"{source.name} to {output.name}", fontsize="medium")
    channels.finish(model, responses.drawn, x)
    write_figure(channels.figure, path)


def _draw_curves(axes: Axes, kind: Callable[[Complex], tuple[Array, Array]], r: _Responses) -> None:
    """Curves of samples, of the nominal model, and of a worst case."""
    draw_grid(axes)
    draw_cloud(axes, *kind(r.samples), COLORS[0], 0.15, "samples")
    for values, color, label in ((r.nominal, "black", "nominal"), (r.worst, WORST, "worst case")):
        if values is not None:
            x, y = kind(values)
            axes.plot(x[0], y[0], color=color, linewidth=1.2, label=label)


def _nyquist(_: System, panels: NDArray[Any], r: _Responses, output: Signal, source: Signal) -> None:
    def both_halves(response: Complex) -> tuple[Array, Array]:
        gap = np.full((len(response), 1), np.nan)
        real, imaginary = response.real, response.imag
        return np.hstack([real, gap, real]), np.hstack([imaginary, gap, -imaginary])

    (axes,) = panels
    _draw_curves(axes, both_halves, r)
    sizes = np.abs(np.concatenate([values.ravel() for values in r.every]))
    reach = float(np.clip(1.1 * np.max(sizes[np.isfinite(sizes)], initial=0.0), 1.5, _NYQUIST))
    turn = np.exp(2j * np.pi * np.linspace(0.0, 1.0, 181))
    axes.plot(turn.real, turn.imag, ":", color="black", linewidth=0.7)
    axes.plot([-1.0], [0.0], "+", color=WORST, markersize=8.0, label="critical point")
    axes.set(xlim=(-reach, reach), ylim=(-reach, reach), aspect="equal")
    axes.set_ylabel(f"imaginary part ({output.unit} / ({source.unit}))", fontsize="small")


def _nichols(_: System, panels: NDArray[Any], r: _Responses, output: Signal, source: Signal) -> None:
    def size_over_phase(response: Complex) -> tuple[Array, Array]:
        return np.stack([_unwrapped(curve) for curve in response]), _size(response)

    (axes,) = panels
    _draw_curves(axes, size_over_phase, r)
    angle = np.linspace(0.0, 2.0 * np.pi, 181)[1:-1]
    for peak in _PEAKS:
        closed = 10.0 ** (peak / 20.0) * np.exp(1j * angle)
        loop = closed / (1.0 - closed)
        label = "" if peak > _PEAKS[0] else "closed loop: 3 and 6 dB"
        axes.plot(
            _unwrapped(loop), decibels(np.abs(loop)), ":", color="black", linewidth=0.8, label=label
        )
    axes.plot([-180.0], [0.0], "+", color=WORST, markersize=8.0, label="critical point")
    set_heights(axes, np.concatenate([_size(values).ravel() for values in r.every]))
    axes.xaxis.set_major_locator(MultipleLocator(_RIGHT_ANGLE))
    axes.set_ylabel(f"size (dB of {output.unit} / ({source.unit}))", fontsize="small")


def _unwrapped(curve: Complex) -> Array:
    """Phases (deg) without jumps, the first in (-360, 0]; nan where the curve is infinite."""
    phases, some = np.full(len(curve), np.nan), np.isfinite(curve) & (curve != 0.0)
    if np.any(some):
        turned = np.degrees(np.unwrap(np.angle(curve[some])))
        phases[some] = turned - 4.0 * _RIGHT_ANGLE * np.ceil(turned[0] / (4.0 * _RIGHT_ANGLE))
    return phases


@arguments_checked
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
    path, model, seed, most_samples
        As for `save_bode`.
    worst : mapping of names to physical values, optional
        A worst case to draw, that is known from elsewhere; by default the sample of the highest peak.
    bound : float, optional
        A guaranteed bound of the gain over the whole range, in its unit, to draw as a line.
    """
    check_figure(path)
    if not (model.inputs and model.outputs):
        raise AnalysisError(
            f"model {model.name!r}: without inputs or outputs there are no singular values to draw. "
            "Choose some in [linearize]."
        )
    r = _responses(model, seed, most_samples, worst)
    samples, nominal = (decibels(frequency.singular_values(values)) for values in (r.samples, r.nominal))
    inside = nominal.shape[2] <= _MOST_BELOW
    unit = f"singular values (dB of {frequency.gain_unit(model)})"
    size = (8.0 if inside else 10.0, 5.0)
    figure, axes = panel(facts(model), "frequency (rad/s)", unit, size, "both")
    over_frequency(axes, *r.ends)
    for k in range(samples.shape[2] if r.drawn else 0):
        label = f"singular value {k + 1}, {r.drawn} samples"
        draw_cloud(axes, r.omega, samples[:, :, k], COLORS[k % len(COLORS)], 0.15, label)
    for k in range(nominal.shape[2]):  # singular values are sorted, so these curves do not cross
        label = "" if k else "nominal"
        axes.plot(r.at_nominal[0], nominal[0, :, k], color="black", linewidth=1.2, label=label)
    if worst is not None and r.worst is not None:
        highest = decibels(frequency.singular_values(r.worst))
        _draw_worst(axes, r.at_worst[0], highest[0, :, 0], "worst case", model, worst)
    elif r.drawn:
        k = int(np.argmax(np.max(frequency.peaks(samples[:, :, 0]), axis=1)))
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
    add_legend(axes, columns=2 if inside else 1, where="lower center" if inside else "right upper")
    write_figure(figure, path)


def _draw_worst(
    axes: Axes, omega: Array, values: Array, what: str, model: System, at: Mapping[str, float]
) -> None:
    """The largest singular value of one sample, and where it has its peak."""
    k = int(np.argmax(frequency.peaks(values[None])[0]))
    label = f"{what}: {values[k]:.1f} dB at {omega[k]:.4g} rad/s"
    direct = np.max(decibels(frequency.singular_values(matrices_at(model, at).D.astype(complex))))
    if direct >= np.max(values):
        label = f"{what}: {direct:.1f} dB at infinite frequency"
    (infinite,) = frequency.unbounded_frequencies(model, at)
    infinite = infinite[(infinite > omega[0]) & (infinite < omega[-1])]
    if len(infinite):
        nearest = infinite[np.argmin(np.abs(infinite - omega[k]))]
        label = f"{what}: unbounded at {nearest:.4g} rad/s"
    axes.plot(omega, values, color=WORST, linewidth=1.0, label=label)


@arguments_checked
def save_step(
    path: str | Path,
    model: System,
    seed: int = 0,
    *,
    outputs: Names = None,
    inputs: Names = None,
    worst: Mapping[str, float] | None = None,
) -> None:
    """Draw step responses of each channel, the nominal model over random samples.

    Parameters
    ----------
    path, model, seed, outputs, inputs, worst
        As for `save_bode`; up to 25 channels.
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
    at_worst = None if worst is None else step_response(model, worst, times, **names).values[0]
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
            if at_worst is not None:
                axes.plot(times, at_worst[:, i, k], color=WORST, linewidth=1.0, label="worst case")
            output, step = model.outputs[row], model.inputs[column]
            axes.set_title(f"step of {step.name} to {output.name}", fontsize="medium")
            axes.set_ylabel(f"{output.unit} / ({step.unit})", fontsize="small")
            axes.set_xlim(0.0, times[-1])
            draw_grid(axes)
            axes.autoscale_view(scalex=False)
    channels.finish(model, count, "time (s)")
    write_figure(channels.figure, path)


@arguments_checked
def save_motions(
    path: str | Path, name: str, times: Array, outputs: Sequence[Signal], runs: Mapping[str, Array]
) -> None:
    """Draw outputs over time, one panel for each, with the curves of some runs.

    Parameters
    ----------
    path : file, whose ending is that of a figure, such as .png
    name : of what moves
    times : array (N,), s
    outputs : sequence of n Signal, at most 25
    runs : mapping of labels to arrays (N, n)
        The second, fourth, ... is drawn with dashes, in the color of the one before it.
    """
    check_figure(path)
    if not 0 < len(outputs) <= _MOST_STEPS:
        raise AnalysisError(f"{name}: {len(outputs)} outputs; expected 1 to {_MOST_STEPS} to draw.")
    columns = panel_columns(1 if len(outputs) < 4 else 2)
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
    add_legend(panels[0, 0], columns=3, where="lower right")
    figure.suptitle(name)
    write_figure(figure, path)
