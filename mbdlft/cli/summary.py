"""The printed form of a model and of an archive: one JSON object, or tables and sentences; `show`."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from mbdlft import archive as archives
from mbdlft import system as systems
from mbdlft.cli import rooms
from mbdlft.cli.options import Archive, AsJson
from mbdlft.cli.output import console, parameters_data, print_json, print_table, say, signals_data
from mbdlft.cli.responses import poles_data, print_poles

if TYPE_CHECKING:
    from mbdlft.system import DeltaThetaModel, LFTModel, System


def report_model(
    model: "LFTModel",
    seconds: Mapping[str, float],
    paths: Mapping[str, Path | None],
    notes: Sequence[str],
    *,
    as_json: bool,
) -> None:
    """Print a model that was made, with `notes`, the `seconds` of each stage and the written files."""
    seconds = {**seconds, "total": sum(seconds.values())}
    if as_json:
        print_json({**_model_data(model), "seconds": seconds, "notes": list(notes)})
        return
    print_model(model)
    say(*notes)
    say("seconds: " + ", ".join(f"{name} {value:.3f}" for name, value in seconds.items()))
    say(*(f"{what}: {path}" for what, path in paths.items() if path is not None))


def show(
    archive: Archive,
    name: Annotated[str | None, typer.Option(help="Only the model of this name.")] = None,
    as_json: AsJson = False,
) -> None:
    """Print what is in an archive, and from when."""
    names = [name] if name else archives.model_names(archive)
    models = [archives.load(archive, key) for key in names]
    sweeps: list[str] = []
    analyses: list[dict[str, Any]] = []
    if name is None:
        sweeps = list(archives.sweep_names(archive))
        for key in archives.analysis_names(archive):
            _, bounds = archives.load_analysis(archive, key)
            ends = {"lower": bounds.lower, "upper": bounds.upper}
            analyses.append({"name": key, "kind": bounds.kind, **ends})
    if as_json:
        beside = {} if name else {"sweeps": sweeps, "analyses": analyses}
        print_json({"models": [_stored_data(model) for model in models], **beside})
        return
    for model in models:
        _print_stored(model)
    if sweeps:
        say(f"sweeps: {', '.join(sweeps)}")
    for entry in analyses:
        lower, upper = (
            f"{entry[end]:.6g}" if math.isfinite(entry[end]) else "unbounded"
            for end in ("lower", "upper")
        )
        say(f"analysis {entry['name']}: {entry['kind']} {lower} to {upper}")


def _print_stored(model: "System | DeltaThetaModel") -> None:
    """Print a model, its nonlinear functions, and from when it is."""
    linear = model if isinstance(model, systems.System) else model.linear
    print_model(linear)
    say(*(f"nonlinear: {function}" for function in getattr(model, "functions", ())))
    if isinstance(linear, systems.LFTModel):
        made = linear.provenance
        say(f"made {made.created} by mbdlft {made.mbdlft}, CasADi {made.casadi}")
        if linear.known_program is not None:
            say(f"stored program: {linear.known_program.length} instructions")


def print_model(model: "System") -> None:
    """Print the signals, parameters and poles of a model, and what its certificate says."""
    console().print(f"{model.name}  {model.description}", style="bold", highlight=False)
    for what in ("states", "inputs", "outputs"):
        signals = getattr(model, what)
        listed = ", ".join(f"{signal.name} ({signal.unit})" for signal in signals)
        console().print(f"{what} ({len(signals)}): {listed}".rstrip(": "), highlight=False)
    if isinstance(model, systems.LFTModel):
        _print_repetitions(model)
        say(*rooms.content.certificate_sentences(model))
        if model.trim.signals:
            pairs = zip(model.trim.signals, model.trim.nominal, strict=True)
            efforts = ", ".join(f"{s.name} = {value:.6g} {s.unit}" for s, value in pairs)
            say(f"trim at nominal: {efforts}")
    else:
        blocks = ", ".join(f"{b.name} ({b.kind}, {b.outputs} x {b.inputs})" for b in model.lft.blocks)
        say(f"order {model.order}: {blocks or 'no blocks'}; stored without evidence")
    print_poles(model)


def _print_repetitions(model: "LFTModel") -> None:
    """Print a row for each parameter: its range and its repetitions, with their sums below."""
    certificate = model.certificate
    counts = (certificate.order, certificate.lower_bound, certificate.raw_order)
    rows = (
        (p.name, p.unit, f"{p.nominal:g}", f"[{p.low:g}, {p.high:g}]", p.role, *map(str, repetitions))
        for p, *repetitions in zip(model.parameters, *counts, strict=True)
    )
    headings = "parameter | unit | nominal > | range > | role | repetitions > | lower bound > | before"
    sums = ("total", "", "", "", "", *(str(sum(count)) for count in counts))
    print_table(None, f"{headings} reduction >", rows, sums)


def _stored_data(model: "System | DeltaThetaModel") -> dict[str, Any]:
    """A stored model as plain data: that of its linear part if it has nonlinear functions."""
    if not isinstance(model, systems.System):
        return {**_stored_data(model.linear), "functions": [str(f) for f in model.functions]}
    if isinstance(model, systems.LFTModel):
        made = {key: getattr(model.provenance, key) for key in ("created", "mbdlft", "casadi")}
        return {**_model_data(model), **made}
    return {"name": model.name, **signals_data(model), "order": model.order}


def _model_data(model: "LFTModel") -> dict[str, Any]:
    """A model and its certificate as plain data."""
    c = model.certificate
    parameters = parameters_data(model.parameters)
    for k, entry in enumerate(parameters):
        for name in ("order", "lower_bound", "gap", "raw_order"):
            entry[name] = getattr(c, name)[k]
        entry["doubtful"] = c.doubtful[k] if c.doubtful else None
    trim = [
        {"name": signal.name, "unit": signal.unit, "nominal": value}
        for signal, value in zip(model.trim.signals, model.trim.nominal, strict=True)
    ]
    as_they_are = (
        *("order_bound", "minimal", "exact_bound", "exact", "truncation_error", "fit_error_bound"),
        *("max_relative_error", "check_points", "well_posed"),
    )
    return {
        "name": model.name,
        **signals_data(model),
        "parameters": parameters,
        "trim": trim,
        **{name: sum(getattr(c, name)) for name in ("order", "lower_bound", "raw_order")},
        **{name: getattr(c, name) for name in as_they_are},
        "transfer_error": c.transfer_error if c.frequencies else None,
        "frequencies": list(c.frequencies),
        "near": list(c.near),
        "by_terms": [list(entry) for entry in c.by_terms],
        "condition": c.condition or None,
        "sign_changes": c.sign_changes if c.condition else None,
        "rounding_ratio": c.rounding_ratio if c.condition else None,
        "open_boxes": [[list(ends) for ends in box] for box in c.open_boxes],
        **poles_data(model),
    }
