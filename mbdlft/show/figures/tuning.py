"""What a tuner came to: goals against limits, steps, poles over the box, gains over the schedule."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from mbdlft.base.arguments import arguments_checked
from mbdlft.base.array import Array
from mbdlft.base.errors import AnalysisError
from mbdlft.base.samples import grid
from mbdlft.response.frequency import frequency_response, response_frequencies, singular_values
from mbdlft.response.modes import poles
from mbdlft.response.time import response_times, step_response
from mbdlft.show.figures import figures
from mbdlft.system.model import System

_MOST_STEPS, _MOST_GAINS = 4, 6  # curves in a panel
_LOOKS, _SETTLED = 3, 0.02  # for the time until all but this part of a curve is over
_LOWEST = 1e-3  # times a limit: what is smaller is not looked at
_VALUES = 101  # of a parameter
_ROOM = 6.5  # letters between a panel and its legend: ticks and a label


Reached: TypeAlias = Any  # of `mbdlft.synthesis`, a room beside this one
Tuning: TypeAlias = Any


@arguments_checked
def save_tuning_figure(path: str | Path, tuning: Tuning, *, seed: int = 0) -> None:
    """Draw what `tune` came to, at the nominal point and at the worst ones that it was tuned on.

    Panels are the gains of goals over their limits, with what is proved; steps of the channels of goals;
    poles of random samples of the box; and gains of scheduled controllers over each of their parameters,
    the others nominal.

    Parameters
    ----------
    path : file, whose ending is that of a figure, such as .png
    tuning : Tuning
    seed : int, of the random samples
    """
    figures.check_figure(path)
    figures.write_figure(tuning_figure(tuning, seed), path)


def tuning_figure(tuning: Tuning, seed: int = 0) -> Figure:
    """The figure of `save_tuning_figure`."""
    gains = [r for r in tuning.goals if r.goal.inputs]
    scheduled = [(c, p.name) for c in tuning.controllers for p in c.parameters]
    kinds = ["goals", "steps"] * bool(gains) + ["poles"] * bool(tuning.loop.states)
    if not kinds:
        raise AnalysisError("the figure of a tuning: no goal has channels, and no loop has states.")
    figure, panels = _panels(len(kinds) + len(scheduled))
    for kind, axes in zip(kinds, panels, strict=False):
        figures.draw_grid(axes)
        if kind == "goals":
            _draw_goals(axes, gains, tuning.points)
        elif kind == "steps":
            _draw_steps(axes, tuning, gains)
        else:
            _draw_poles(axes, tuning, seed)
        _below(axes)
    for (controller, name), axes in zip(scheduled, panels[len(kinds) :], strict=True):
        figures.draw_grid(axes)
        _draw_schedule(axes, controller, name, tuning.loop)
        _below(axes)
    figure.suptitle(f"{', '.join(c.name for c in tuning.controllers)}: {len(tuning.points)} points")
    return figure


def _panels(count: int) -> tuple[Figure, list[Axes]]:
    """Panels in two columns; of an odd number the first one takes a whole row."""
    columns = figures.panel_columns(2)
    wide = count % columns
    rows = (count + wide) // columns
    figure = Figure(figsize=(6.0 * columns, 4.2 * rows), layout="constrained")
    places = figure.add_gridspec(rows, columns)
    first = [places[0, :]] if wide else []
    free = [places[k // columns, k % columns] for k in range(columns * wide, rows * columns)]
    return figure, [figure.add_subplot(place) for place in (*first, *free)]


def _below(axes: Axes) -> None:
    """A legend below the label of a panel, where it covers no curve."""
    axes.legend(
        fontsize="x-small",
        ncols=figures.panel_columns(3),
        loc="upper center",
        bbox_to_anchor=(0.5, 0.0),
        borderaxespad=_ROOM,
    )


def _own(system: System, point: Mapping[str, float]) -> dict[str, float]:
    """Values of the parameters that a system has."""
    return {name: point[name] for name in system.parameters.names if name in point}


def _draw_goals(axes: Axes, gains: Sequence[Reached], points: Sequence[Mapping[str, float]]) -> None:
    omega = np.unique(np.concatenate([response_frequencies(r.loop)[0] for r in gains]))
    top = 1.0
    for k, reached in enumerate(gains):
        color, limit = figures.COLORS[k % len(figures.COLORS)], reached.goal.limit
        for j, point in enumerate(points):
            response = frequency_response(reached.loop, _own(reached.loop, point), omega)[0]
            sizes = singular_values(response)[:, 0] / limit
            label = reached.goal.name if not j else None
            axes.plot(omega, sizes, color=color, linewidth=0.6 if j else 1.4, label=label)
            top = max(top, float(np.max(sizes)))
        if np.isfinite(reached.proved):
            axes.axhline(reached.proved, color=color, linewidth=0.8, linestyle=":")
    axes.axhline(1.0, color=figures.WORST, linewidth=1.0, linestyle="--", label="limit")
    figures.over_frequency(axes, float(omega[0]), float(omega[-1]))
    axes.set(
        yscale="log", ylim=(_LOWEST, 2.0 * top), xlabel="frequency (rad/s)", ylabel="gain over limit",
        title="goals: nominal thick, worst points thin, proved dotted",
    )  # fmt: skip


def _draw_steps(axes: Axes, tuning: Tuning, gains: Sequence[Reached]) -> None:
    pairs = [(r.goal.inputs[0], r.goal.outputs[0]) for r in gains]
    names = [s.name for s in tuning.loop.inputs], [s.name for s in tuning.loop.outputs]
    chosen = [(names[1].index(y), names[0].index(u)) for u, y in dict.fromkeys(pairs)][:_MOST_STEPS]
    values_at = [_own(tuning.loop, point) for point in tuning.points]
    times, settled = response_times(tuning.loop), np.zeros(0)
    for count in range(_LOOKS):  # slow modes that are hardly seen leave all others at the left edge
        values = [step_response(tuning.loop, point, times).values[0] for point in values_at]
        curves = np.array([[value[:, row, column] for row, column in chosen] for value in values])
        sizes = np.maximum(np.max(np.abs(curves), axis=(0, 2)), np.finfo(float).tiny)
        settled = settled if count else curves[:, :, -1:]
        moving = np.abs(curves - settled) > _SETTLED * sizes[:, None]
        end = times[min(int(np.max(np.nonzero(moving)[2], initial=0)) + 2, len(times) - 1)]
        times = np.linspace(0.0, end, len(times))
    values = [step_response(tuning.loop, point, times).values[0] for point in values_at]
    for k, (row, column) in enumerate(chosen):  # long dashes below shorter ones: equal curves are seen
        style = "-" if not k else (0, (8.0 / k, 8.0 / k))
        for j, value in enumerate(values):
            label = f"{names[0][column]} to {names[1][row]}, over {sizes[k]:.3g}" if not j else None
            width = 0.6 if j else 1.4
            curve = value[:, row, column] / sizes[k]
            axes.plot(
                times, curve, color=figures.COLORS[k], linewidth=width, linestyle=style, label=label
            )
    axes.set(xlim=(0.0, times[-1]), xlabel="time (s)", ylabel="step response over its largest value")
    axes.set_title("steps: nominal thick, worst points thin")


def _draw_poles(axes: Axes, tuning: Tuning, seed: int) -> None:
    loop = tuning.loop
    if loop.parameters:
        values, count = figures.drawn_samples(loop, seed)
        cloud = poles(loop, values).ravel()
        axes.plot(
            cloud.real, cloud.imag, ".", color=figures.COLORS[0], markersize=3.0,
            markeredgewidth=0.0, alpha=0.5, label=f"{count} samples",
        )  # fmt: skip
    for j, point in enumerate(tuning.points):
        roots = poles(loop, _own(loop, point))[0]
        mark, color = ("x", "black") if not j else ("o", figures.WORST)
        label = ("nominal", "worst points", None)[min(j, 2)]
        axes.plot(
            roots.real, roots.imag, mark, color=color, markersize=5.0, fillstyle="none", label=label
        )
    axes.axvline(0.0, color="black", linewidth=0.8)
    size = 10.0 ** round(float(np.log10(np.median(np.abs(roots)) or 1.0)))
    for axis, set_scale in ((axes.xaxis, axes.set_xscale), (axes.yaxis, axes.set_yscale)):
        low, high = axis.get_view_interval()
        if max(-low, high) > size:  # else the ends of the axis would be its ticks
            set_scale("symlog", linthresh=size)
        axis.set_major_formatter("{x:.3g}")
    axes.set(xlabel="real part (rad/s)", ylabel="imaginary part (rad/s)", title="poles over the box")


def _draw_schedule(axes: Axes, controller: System, name: str, loop: System) -> None:
    """The largest gain of a controller over a parameter, at slow to fast frequencies of the loop."""
    sizes: Array = np.abs(poles(loop)[0])
    low, high = np.quantile(sizes, [0.1, 0.9])
    omega = np.geomspace(low, high, _MOST_GAINS - 2) if low > 0.0 else np.array([high or 1.0])
    values = grid(controller.parameters, {name: _VALUES})
    gains = singular_values(frequency_response(controller, values, omega))[:, :, 0]
    for k, w in enumerate(omega):
        axes.plot(values[name], gains[:, k], color=figures.COLORS[k], label=f"{w:.3g} rad/s")
    unit = controller.parameters[name].unit
    axes.set(xlabel=f"{name} ({unit})", ylabel="largest gain", title=f"{controller.name} over {name}")
