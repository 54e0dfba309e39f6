"""What is known of a model, as texts: a verdict, and the rows of a report's tables."""

import math
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from mbdlft.base.array import Array
from mbdlft.base.errors import MbdlftError
from mbdlft.base.samples import corners, random
from mbdlft.response.modes import cells, damping_table
from mbdlft.robust.evidence import Bounds
from mbdlft.robust.proofs import verify
from mbdlft.robust.stability import check_stability
from mbdlft.show.report.sentences import largest_error
from mbdlft.show.viewer.page import scene_of
from mbdlft.system.model import LFTModel, System
from mbdlft.system.sampled import trim_at

_MOST_SAMPLES, _FEWEST, _STATES = 100, 20, 2e4  # samples; the most states^2 times samples: seconds
_MOST_CORNERS = 10  # parameters, whose corners are tried
_SAMPLES = 300  # of the trim, as many as figures have
_ROUNDING = 1e-12  # of the largest value: what is less is rounding and shown as 0
_KINDS = {
    "BoxProof": "boxes of values",
    "LyapunovProof": "Lyapunov functions on boxes of values",
    "IntervalProof": "intervals of frequency",
    "MotionProof": "a function that falls along all motions",
    "PolynomialProof": "a polynomial that falls along all motions",
}
_SCENE, _MATRIX = "mbdlft-scene/", "mbdlft-matrix/"  # in texts that models are made of


class ParameterRow(NamedTuple):
    """A parameter, and its repetitions: before reduction, of the model, proved to be needed."""

    name: str
    unit: str
    nominal: str
    range: str
    role: str
    before: int | None
    order: int
    bound: int | None


class TrimRow(NamedTuple):
    """An effort at equilibrium: at nominal, and the least and largest that were found."""

    name: str
    unit: str
    nominal: str
    least: str
    largest: str


class Worst(NamedTuple):
    """A stored analysis: what is proved, the worst case, and what the proof is."""

    title: str
    proved: bool
    sentences: tuple[str, ...]
    rows: tuple[tuple[str, str, str, str, str], ...]


def short(value: float) -> str:
    """A number of six digits."""
    return f"{value:.6g}"


def parameter_rows(model: System) -> tuple[ParameterRow, ...]:
    """One row for each parameter."""
    certificate = model.certificate if isinstance(model, LFTModel) else None
    repeated = {block.name: block.inputs for block in model.lft.blocks}
    return tuple(
        ParameterRow(
            p.name,
            p.unit,
            short(p.nominal),
            f"{short(p.low)} to {short(p.high)}",
            p.role,
            certificate.raw_order[k] if certificate else None,
            repeated.get(p.name, 0),
            certificate.lower_bound[k] if certificate else None,
        )
        for k, p in enumerate(model.parameters)
    )


def verdict_sentence(model: System) -> str:
    """The first thing that a reader wants to know of the order and of exactness."""
    if not isinstance(model, LFTModel):
        return f"The model has order {model.order}; it is stored without evidence."
    c, match = model.certificate, model.provenance.scene
    made = "the connection of its parts"
    if _SCENE in match:
        made = "trimming and linearizing the nonlinear equations again"
    elif _MATRIX in match:
        made = "the matrix"
    exact = "The model is an approximation."
    if c.exact:
        exact = f"The model equals {made} at every value of the parameters, up to rounding."
    if c.minimal:
        size = f"Its order, all repetitions of parameters, is {model.order}: proved to be the least."
    else:
        size = (
            f"Its order, all repetitions of parameters, is {model.order}; it is proved that every such "
            f"model has at least {c.order_bound}."
        )
    return f"{exact} {size}"


def summary(
    model: System, stability: Sequence[str], worst: Sequence[Worst], archive: str | Path | None
) -> tuple[tuple[str, str], ...]:
    """Four lines: what the model is, what is proved, what was looked at, and what is to be done next."""
    counts = (
        f"States: {len(model.states)}, inputs: {len(model.inputs)}, outputs: {len(model.outputs)}, "
        f"parameters: {', '.join(p.name for p in model.parameters) or 'none'}."
    )
    checked = [f"{stability[0][0].upper()}{stability[0][1:]}."] if stability else []
    if isinstance(model, LFTModel):
        error = largest_error(model)
        checked.append(f"{error[0].upper()}{error[1:]}.")
    proved = [verdict_sentence(model)]
    proved += [f"{case.title}: {case.sentences[0]}" for case in worst if case.proved]
    return (
        ("What it is", f"A linear model that holds for all values of its parameters. {counts}"),
        ("How sure", " ".join(proved)),
        ("What was seen", " ".join(checked) or "Nothing: the model has no states and no evidence."),
        ("What next", next_step(model, stability, worst, archive)),
    )


def next_step(
    model: System, stability: Sequence[str], worst: Sequence[Worst], archive: str | Path | None
) -> str:
    """The one thing that is most worth doing, with its command."""
    file = Path(archive).name if archive is not None else f"{model.name}.h5"
    if isinstance(model, LFTModel) and model.certificate.well_posed != "proved":
        return "Prove that it is regular at all values: mbdlft linearize with a larger --prove."
    if any("unstable at nominal" in sentence for sentence in stability):
        return f"It is unstable at nominal: close a loop (mbdlft tune {file}), then ask for its margin."
    if any(not case.proved for case in worst):
        return f"A stored analysis is not proved: mbdlft margin {file} with a larger --work."
    try:
        scene_of(model)
        view = f"mbdlft view {file}"
    except MbdlftError:
        view = ""
    if worst:
        return f"Look at the worst cases below{f', and in the picture: {view}' * bool(view)}."
    if model.parameters and stability:
        return f"Nothing is known of its margins yet: mbdlft margin {file} proves one for all values."
    return f"Look at it: {f'{view}, or ' * bool(view)}mbdlft response {file}."


def trim_rows(model: System) -> tuple[tuple[TrimRow, ...], int]:
    """Efforts at equilibrium over corners and samples, and at how many points."""
    if not isinstance(model, LFTModel) or not model.trim.signals:
        return (), 0
    values = _points(model)
    efforts = trim_at(model, values).reshape(-1, len(model.trim.signals))
    rows = [
        TrimRow(
            signal.name,
            signal.unit,
            short(nominal),
            _no_rounding(min(np.min(column), nominal), column),
            _no_rounding(max(np.max(column), nominal), column),
        )
        for signal, nominal, column in zip(model.trim.signals, model.trim.nominal, efforts.T, strict=True)
    ]
    return tuple(rows), len(efforts) if values else 1


def _no_rounding(value: float, column: Array) -> str:
    """A number, or 0 if it is rounding beside the largest of its column."""
    largest = float(np.max(np.abs(column)))
    return short(0.0 if abs(value) <= _ROUNDING * largest else float(value))


def _points(model: System) -> Mapping[str, Array]:
    """Corners, of few parameters, and random samples."""
    if not model.parameters:
        return {}
    samples = random(model.parameters, _SAMPLES, 0)
    if len(model.parameters) > _MOST_CORNERS:
        return samples
    ends = corners(model.parameters)
    return {name: np.concatenate([ends[name], samples[name]]) for name in samples}


def samples_of(model: System) -> int:
    """How many samples a report looks at: fewer of a large model, as it is to be made in seconds."""
    size = max(1, len(model.states)) ** 2
    return int(max(_FEWEST, min(_MOST_SAMPLES, _STATES / size)))


def pole_rows(model: System) -> tuple[tuple[str, ...], ...]:
    """Poles at nominal: value, natural frequency (rad/s, Hz), damping, time constant."""
    if not model.states:
        return ()
    return tuple(tuple(cell.strip() for cell in cells(row)) for row in damping_table(model).rows())


def stability_sentences(model: System) -> tuple[str, ...]:
    """Whether values of the parameters make the model unstable, and the least damping of samples."""
    if not model.states:
        return ()
    count = samples_of(model)
    said = [str(check_stability(model, count))]
    if model.parameters:
        values = random(model.parameters, count, 0)
        table = damping_table(model, values)
        swings = (np.abs(table.poles.imag) > 0.0) & (table.natural_frequency > 0.0)
        if np.any(swings):
            damping = np.where(swings, table.damping, np.inf)
            k, j = np.unravel_index(int(np.argmin(damping)), damping.shape)
            at = ", ".join(f"{name} = {short(float(v[k]))}" for name, v in values.items())
            said.append(
                f"The least damping of a pole that swings, among {count} random samples, is "
                f"{float(damping[k, j]):.4g}, at {table.natural_frequency[k, j]:.4g} rad/s; {at}."
            )
    return tuple(said)


def tuned_of(loop: System) -> list[str]:
    """Names of the controllers whose goal the gain of a loop is, as `save_tuning` writes them."""
    said = re.match("goal of (.*?): ", loop.description)
    return said[1].split(", ") if said else []


def goal_lines(model: System) -> list[str]:
    """What a controller was tuned for, and what was found, as `save_tuning` writes it; nothing else."""
    first, *lines = model.description.splitlines() or [""]
    matches = (re.match(r".*? \((hard|soft)\): tuned [^\s,;]+, worst found [^\s,;]+", x) for x in lines)
    return [match[0] for match in matches if match] if first == "tuned:" else []


def worst_cases(analyses: Sequence[tuple[str, System, Bounds]]) -> tuple[Worst, ...]:
    """The analyses that are stored beside the model."""
    worst = []
    for name, system, bounds in analyses:
        wrong = verify(system, bounds)
        worst.append(Worst(name, not wrong, tuple(_said(bounds, wrong)), worst_rows(system, bounds)))
    return tuple(worst)


def worst_rows(system: System, bounds: Bounds) -> tuple[tuple[str, str, str, str, str], ...]:
    """Of each parameter its value in the worst case, unit, delta, and share of the sensitivity."""
    units = {p.name: p.unit for p in system.parameters}
    share, delta = bounds.sensitivity, bounds.delta
    return tuple(
        (name, short(value), units[name], _delta(delta.get(name, 0.0)), f"{share.get(name, 0.0):.3f}")
        for name, value in bounds.worst.items()
    )


def _delta(value: object) -> str:
    return f"{value:.4f}" if isinstance(value, float | int | complex) else "a matrix"


def _said(bounds: Bounds, wrong: str) -> list[str]:
    """Sentences on one analysis, in whose proof something is wrong, or nothing."""
    claim = str(bounds.claim)
    reached, infinite = bounds.reached, bounds.is_from_above and math.isinf(bounds.reached)
    said = ["Nothing is proved." if wrong else f"{claim[0].upper()}{claim[1:]}: proved."]
    if infinite:
        said = ["It is infinite: there is no bound to prove."]
    elif wrong and bounds.proof is not None:
        said.append(f"The proof that is stored is none: {wrong.rstrip('.')}.")
    if bounds.worst and math.isfinite(reached):
        said.append(f"Reached: {short(reached)}, at {short(bounds.frequency)} rad/s, at these values.")
    if bounds.motion is not None:
        said.append(
            f"A motion of {short(reached)} times the ranges that does not come to rest is stored."
        )
    if bounds.reason:
        said.append(f"{'Why' if infinite else 'Why not more'}: {bounds.reason.rstrip('.')}.")
    if not wrong and bounds.proof is not None:
        kind = _KINDS[type(bounds.proof).__name__]
        said.append(f"The proof, by {kind}, is stored, and was checked when this page was made.")
    return said
