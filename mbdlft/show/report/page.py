"""The report of a model: one page without scripts, which a browser shows and prints."""

import importlib.metadata
from collections.abc import Sequence
from pathlib import Path

from mbdlft.base.errors import AnalysisError, MbdlftError
from mbdlft.robust.evidence import Bounds
from mbdlft.show.report.content import (
    certificate_sentences,
    parameter_rows,
    pole_rows,
    stability_sentences,
    trim_rows,
    verdict_sentence,
    worst_cases,
)
from mbdlft.show.report.figures import pole_figure, response_figures
from mbdlft.show.viewer.page import Page, scene_of
from mbdlft.show.viewer.picture import View, scene_pictures
from mbdlft.system.model import LFTModel, System

_FOLDER = Path(__file__).parent / "assets"
_VIEWS = (
    (View(0.9, 0.35, names=True), ""),
    (View(0.0, 0.0, names=False), "along x"),
    (View(1.5708, 0.0, names=False), "along y"),
    (View(0.0, 1.5708, names=False), "from above"),
)


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

    Raises
    ------
    AnalysisError
        `model` is none.
    ArchiveError
        The archive cannot be read.
    """
    import jinja2
    from markupsafe import Markup

    if not isinstance(model, System):
        raise AnalysisError(
            f"report: expected an LFTModel or a System, got {type(model).__name__}. to_lft(scene) makes "
            "one of a scene."
        )
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(_FOLDER),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    trim, points = trim_rows(model)
    html = environment.get_template("report.html").render(
        model=model,
        version=importlib.metadata.version("mbdlft"),
        style=Markup((_FOLDER / "report.css").read_text(encoding="utf-8")),
        pictures=_pictures(model),
        verdict=verdict_sentence(model),
        parameters=parameter_rows(model),
        sentences=certificate_sentences(model),
        trim=trim,
        trim_points=points,
        poles=pole_rows(model),
        stability=stability_sentences(model),
        pole_figure=pole_figure(model),
        responses=response_figures(model),
        worst=worst_cases(_analyses(model, archive)),
        archive=None if archive is None else Path(archive).name,
        provenance=model.provenance if isinstance(model, LFTModel) else None,
    )
    return Page(model.name, html)


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
    """The analyses of an archive that are of this model, or of loops with it."""
    from mbdlft.archive.analysis import analysis_names, load_analysis

    if archive is None:
        return ()
    found = []
    for name in analysis_names(archive):
        system, bounds = load_analysis(archive, name)
        if system.name == model.name or system.name.startswith(f"{model.name} with "):
            found.append((name, system, bounds))
    return found
