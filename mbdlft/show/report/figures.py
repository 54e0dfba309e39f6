"""Figures of a report, as addresses of pictures that are in the page itself."""

import base64
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from mbdlft.base.errors import AnalysisError
from mbdlft.system.model import System

_MOST_CHANNELS = 1  # whose Bode diagrams are in a report; `mbdlft response` draws those of more


_MOST_SAMPLES, _FEWEST, _STATES = 100, 20, 2e4  # samples; the most states^2 times samples


class Picture(NamedTuple):
    """A figure: its address, and a sentence below it."""

    address: str
    caption: str


def samples_of(model: System) -> int:
    """How many samples a report looks at: fewer of a large model, as it is to be made in seconds."""
    size = max(1, len(model.states)) ** 2
    return int(max(_FEWEST, min(_MOST_SAMPLES, _STATES / size)))


def response_figures(model: System) -> tuple[Picture, ...]:
    """Singular values, and Bode diagrams of a model with few channels."""
    from mbdlft.show.figures.responses import save_bode, save_singular_values

    if not (model.inputs and model.outputs):
        return ()
    found = [
        _drawn(
            lambda file: save_singular_values(file, model, most_samples=samples_of(model)),
            "Singular values at nominal and at random samples of the parameters; every sample has its "
            "own frequencies, around its poles. Samples are no bound of the range.",
        )
    ]
    if len(model.inputs) * len(model.outputs) <= _MOST_CHANNELS:
        found.append(
            _drawn(
                lambda file: save_bode(file, model, most_samples=samples_of(model)),
                "Size and phase of each channel, at nominal and at random samples.",
            )
        )
    return tuple(picture for picture in found if picture is not None)


def pole_figure(model: System) -> Picture | None:
    """Poles at nominal and at random samples; None without states."""
    from mbdlft.show.figures.pole_maps import save_pole_map

    if not model.states:
        return None
    return _drawn(
        lambda file: save_pole_map(file, model, most_samples=samples_of(model)),
        "Poles at nominal and at random samples; right of the axis is unstable.",
    )


def _drawn(save: Callable[[Path], None], caption: str) -> Picture | None:
    """A figure that `save` writes; None if there is nothing that can be drawn."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "figure.png"
        try:
            save(file)
        except AnalysisError:
            return None
        text = base64.b64encode(file.read_bytes()).decode("ascii")
    return Picture(f"data:image/png;base64,{text}", caption)
