"""The cloud of singular values: the nominal model, samples, and the worst of them."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure

from mbdlft.base.array import Array
from mbdlft.base.errors import AnalysisError
from mbdlft.response.frequency import (
    frequency_response,
    gain_unit,
    peaks,
    singular_values,
    unbounded_frequencies,
)
from mbdlft.show.figures.figures import (
    COLORS,
    SAMPLES,
    WORST,
    check_figure,
    decibels,
    drawn_frequencies,
    drawn_samples,
    mark_unbounded,
    over_frequency,
    set_heights,
    write_figure,
)
from mbdlft.system.model import System

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
