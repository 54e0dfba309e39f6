"""Step responses, one panel for each channel."""

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from mbdlft.response.modes import Names
from mbdlft.response.time import response_times, step_response
from mbdlft.show.figures.figures import (
    COLORS,
    check_figure,
    drawn_channels,
    drawn_samples,
    write_figure,
)
from mbdlft.system.model import System

_MOST = 25  # channels that one figure has room for


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
    rows, columns = drawn_channels(model, outputs, inputs, _MOST)
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
