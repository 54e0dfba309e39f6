"""Figures of finished models."""

from pathlib import Path

import numpy as np
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure

from mbdlft.analyze import frequency_response, singular_values
from mbdlft.base.array import Array
from mbdlft.base.errors import AnalysisError
from mbdlft.base.samples import random
from mbdlft.system.model import LFTModel, matrices_at

SAMPLES = 300
_OFF_POLE = 1e-4  # no response is drawn nearer to an undamped pole, relative to its frequency
_POINTS_PER_DECADE, _MARGIN_DECADES = 120, 1.0
_MOST_INSIDE = 4  # most singular values whose legend has room inside the axes
_COLORS = ("#4477aa", "#cc6677", "#228833", "#aa7711", "#66ccee", "#aa3377")


def frequencies(model: LFTModel) -> Array:
    """Frequencies (rad/s) around the poles of the nominal model, a decade to either side."""
    poles = np.abs(np.linalg.eigvals(model.A))
    poles = poles[poles > 1e-6 * np.max(poles, initial=1e-300)]
    low, high = (np.min(poles), np.max(poles)) if len(poles) else (1.0, 1.0)
    start, stop = np.log10(low) - _MARGIN_DECADES, np.log10(high) + _MARGIN_DECADES
    return np.logspace(start, stop, int((stop - start) * _POINTS_PER_DECADE) + 1)


def off_poles(omega: Array, poles: Array) -> Array:
    """Frequencies (rad/s) without those of undamped poles, where a response is infinite.

    A frequency that is nearer to that of a pole than a ten-thousandth of it is moved to this distance
    above it.

    Parameters
    ----------
    omega : array (n,), rising
    poles : complex array (m,), rad/s
    """
    undamped = np.unique(np.abs(poles.imag[np.abs(poles.real) <= _OFF_POLE * np.abs(poles.imag)]))
    for pole in undamped[undamped > 0.0]:
        omega = np.where(np.abs(omega - pole) < _OFF_POLE * pole, (1.0 + _OFF_POLE) * pole, omega)
    return np.unique(omega)


def check_figure(path: str | Path) -> None:
    """Raise an error if it is known before the work that a figure cannot be written here.

    Raises
    ------
    AnalysisError
        Its folder does not exist, or its ending is not that of a figure.
    """
    file, endings = Path(path), Figure().canvas.get_supported_filetypes()
    problem = ""
    if not file.parent.is_dir():
        problem = f"{file.parent} is not a folder."
    elif file.suffix[1:].lower() not in endings:
        known = ", ".join(sorted(endings))
        problem = f"expected the ending {known}, got {file.suffix!r}."
    if problem:
        raise AnalysisError(f"{file}: the figure cannot be written: {problem}")


def save_singular_values(path: str | Path, model: LFTModel, seed: int = 0) -> None:
    """Draw the singular values of the nominal model over those of 300 random samples.

    Parameters
    ----------
    path : file, whose ending is that of a figure, such as .png
    model : LFTModel
    seed : int
        Seed of the samples.

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
    values = random(model.parameters, SAMPLES, seed)
    drawn = [matrices_at(model, values).A, model.A]
    poles = np.concatenate([np.linalg.eigvals(A).ravel() for A in drawn]).astype(complex)
    omega = off_poles(frequencies(model), poles)
    samples = _decibels(singular_values(frequency_response(model, values, omega)))
    nominal = _decibels(singular_values(frequency_response(model, {}, omega)))[0]
    count = nominal.shape[1]
    figure = Figure(figsize=(8.0 if count <= _MOST_INSIDE else 10.0, 5.0), layout="constrained")
    axes = figure.add_subplot()
    for k in range(count):
        color, label = _COLORS[k % len(_COLORS)], f"singular value {k + 1}, {SAMPLES} samples"
        lines = [np.column_stack([omega, sample]) for sample in samples[:, :, k]]
        axes.add_collection(LineCollection(lines, colors=color, linewidths=0.5, alpha=0.15))
        axes.plot([], [], color=color, linewidth=2.0, alpha=0.5, label=label)
    for k in range(count):  # singular values are sorted, so these curves do not cross
        label = "" if k else "nominal"
        axes.plot(omega, nominal[:, k], color="black", linewidth=1.2, label=label)
    axes.set(xscale="log", xlim=(omega[0], omega[-1]))
    axes.set_xlabel("frequency (rad/s)")
    axes.set_ylabel(f"singular values (dB of {_gain_unit(model)})")
    axes.set_title(f"{model.name}: {len(model.parameters)} parameters, order {model.order}")
    axes.grid(visible=True, which="both", linewidth=0.3, alpha=0.5)
    if count <= _MOST_INSIDE:
        axes.legend(loc="lower left", fontsize="small")
    else:
        figure.legend(loc="outside right upper", fontsize="small")
    axes.autoscale_view(scalex=False)
    try:
        figure.savefig(path, dpi=150)
    except (OSError, ValueError) as error:
        raise AnalysisError(f"{path}: the figure cannot be written: {error}.") from None


def _decibels(values: Array) -> Array:
    """20 log10 of values, elementwise."""
    return 20.0 * np.log10(np.maximum(values, np.finfo(float).tiny))


def _gain_unit(model: LFTModel) -> str:
    """Unit of the gain, or ``mixed units`` if the outputs or the inputs have several units."""
    pairs = {(y.unit, u.unit) for y in model.outputs for u in model.inputs}
    if len(pairs) > 1:
        return "mixed units"
    over, under = (f"({unit})" if " " in unit or "/" in unit else unit for unit in pairs.pop())
    return f"{over}/{under}"
