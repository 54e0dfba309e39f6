"""The report of a model: one page without scripts, which a browser shows and prints."""

import base64
import tempfile
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

from mbdlft.archive.analysis import analysis_names, load_analysis
from mbdlft.base.arguments import arguments_checked
from mbdlft.base.errors import AnalysisError, MbdlftError
from mbdlft.robust.evidence import GAIN, Bounds
from mbdlft.show.figures.properties import save_pole_map
from mbdlft.show.figures.responses import save_bode, save_singular_values
from mbdlft.show.report import content, sentences
from mbdlft.show.viewer.page import Page, rendered, scene_of
from mbdlft.show.viewer.stills import View, scene_pictures
from mbdlft.system.model import LFTModel, System

_FOLDER = Path(__file__).parent / "assets"
_MOST_CHANNELS = 1  # whose Bode diagrams are in a report; `mbdlft response` draws those of more
_SINGULAR_VALUES = (
    "Singular values at nominal and at random samples of the parameters; every sample has its own "
    "frequencies, around its poles. Samples are no bound of the range."
)
_VIEWS = (
    (View(0.9, 0.35, names=True), ""),
    (View(0.0, 0.0, names=False), "along x"),
    (View(1.5708, 0.0, names=False), "along y"),
    (View(0.0, 1.5708, names=False), "from above"),
)


@arguments_checked
def model_report(model: System, archive: str | Path | None = None) -> Page:
    """The report of a model: what it is, what is proved of it, equilibrium, poles, responses.

    Parameters
    ----------
    model : LFTModel or System
    archive : file, optional
        Where analyses of the model are stored, with their proofs: worst cases, margins.

    Returns
    -------
    Page
        ``model_report(model).save("report.html")`` writes it; a notebook shows it.
    """
    trim, points = content.trim_rows(model)
    stability = content.stability_sentences(model)
    analyses = _analyses(model, archive)
    worst = content.worst_cases(analyses)
    html = rendered(
        _FOLDER / "report.html",
        _FOLDER / "report.css",
        model=model,
        pictures=_pictures(model),
        summary=content.summary(model, stability, worst, archive),
        parameters=content.parameter_rows(model),
        sentences=sentences.certificate_sentences(model),
        trim=trim,
        trim_points=points,
        poles=content.pole_rows(model),
        stability=stability,
        pole_figure=pole_figure(model),
        responses=response_figures(model),
        goals=content.goal_lines(model),
        goal_figures=goal_figures(analyses, [case.proved for case in worst]),
        worst=worst,
        archive=None if archive is None else Path(archive).name,
        provenance=model.provenance if isinstance(model, LFTModel) else None,
    )
    return Page(model.name, html)


class Picture(NamedTuple):
    """A figure: its address, and a sentence below it."""

    address: str
    caption: str


def response_figures(model: System) -> tuple[Picture, ...]:
    """Singular values, and Bode diagrams of a model with few channels."""
    channels = len(model.inputs) * len(model.outputs)
    pictures: list[Picture] = []
    for save, most_channels, caption in (
        (save_singular_values, channels, _SINGULAR_VALUES),
        (save_bode, _MOST_CHANNELS, "Size and phase of each channel, at nominal and at random samples."),
    ):
        if 0 < channels <= most_channels:
            pictures += _drawn(
                partial(save, model=model, most_samples=content.samples_of(model)), caption
            )
    return tuple(pictures)


def goal_figures(
    analyses: Sequence[tuple[str, System, Bounds]], proved: Sequence[bool]
) -> tuple[Picture, ...]:
    """Gains of the loops of goals, with the worst case and what is proved."""
    pictures: list[Picture] = []
    for (_, loop, bounds), is_proved in zip(analyses, proved, strict=True):
        if content.tuned_of(loop) and bounds.kind == GAIN:
            shown: Any = {"worst": bounds.worst, "bound": bounds.upper if is_proved else None}
            save = partial(
                save_singular_values, model=loop, most_samples=content.samples_of(loop), **shown
            )
            also = ", and the bound that is proved" * is_proved
            pictures += _drawn(save, f"A {loop.description}: nominal, samples, the worst case{also}.")
    return tuple(pictures)


def pole_figure(model: System) -> Picture | None:
    """Poles at nominal and at random samples; None without states."""
    save = partial(save_pole_map, model=model, most_samples=content.samples_of(model))
    caption = "Poles at nominal and at random samples; right of the axis is unstable."
    return next(iter(_drawn(save, caption)), None)


def _drawn(save: Callable[[Path], None], caption: str) -> list[Picture]:
    """A figure that `save` writes; none if there is nothing that can be drawn."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "figure.png"
        try:
            save(file)
        except AnalysisError:
            return []
        text = base64.b64encode(file.read_bytes()).decode("ascii")
    return [Picture(f"data:image/png;base64,{text}", caption)]


def _pictures(model: System) -> list[tuple[object, str]]:
    """The scene, if the model was made of one, from four sides: an SVG element and what it is."""
    from markupsafe import Markup

    try:
        scene = scene_of(model)
        drawn = scene_pictures(scene, [view for view, _ in _VIEWS])
    except MbdlftError:
        return []
    return [(Markup(picture), said) for picture, (_, said) in zip(drawn, _VIEWS, strict=True)]


def _analyses(model: System, archive: str | Path | None) -> Sequence[tuple[str, System, Bounds]]:
    """The analyses of an archive that are of this model, or of loops with it or tuned for it."""
    if archive is None:
        return ()
    stored = [(name, *load_analysis(archive, name)) for name in analysis_names(archive)]
    return [
        (name, system, bounds)
        for name, system, bounds in stored
        if system.name == model.name
        or system.name.startswith(f"{model.name} with ")
        or model.name in content.tuned_of(system)
    ]
