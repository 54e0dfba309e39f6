"""What is known of a system that is made of others: one rule per operation.

Of parts that are wired (`composed`): the whole is exact if all parts are. Errors of equilibrium
positions that are fits stay what they are: everything else holds at the fitted positions. A truncation
has a guaranteed bound for its own inputs and outputs only, and no theorem carries it through a wiring:
the bound of the whole is infinite. Lower bounds are computed anew, on the whole. The error is measured:
the whole against state-space formulas of the sampled parts, at random points and corners, and to this is
added what the errors of the parts, as their certificates say, make of the whole there (to first order).

An exchange of inputs and outputs, or another range of a parameter, is a change of coordinates of one
part: it changes no McMillan degree, so bounds stay. Opened blocks and truncations have their own rules.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from datetime import UTC, datetime
from importlib.metadata import version
from typing import Any, NamedTuple

import numpy as np

from mbdlft.base.array import Array
from mbdlft.base.errors import AnalysisError, StructureError, WellPosednessError
from mbdlft.base.parameter import Parameter, deltas_at, to_delta, to_physical
from mbdlft.base.samples import check_points
from mbdlft.base.unit import Signal
from mbdlft.exact.rounding import EPS, MOST_ROUNDINGS, largest
from mbdlft.lft.determinant import values_at, vanishes
from mbdlft.lft.lft import LFT, fix, stack_rows, with_blocks
from mbdlft.lft.sampling import evaluate, evaluate_at, rounding_sizes
from mbdlft.order.degree import degree_bounds, moved
from mbdlft.system.conversion import check_once
from mbdlft.system.free import free_motions
from mbdlft.system.model import Certificate, LFTModel, Parameters, Provenance, System, Trim
from mbdlft.system.regular import PROVED, well_posed
from mbdlft.system.wiring import Wiring, plain_wiring, reduced, wire, wired_values

_LOOKED_AT = 8  # points at which cancellation in LFTs is looked at
_SEED = 0
_RADIUS = 0.5  # of complex and full deltas at the points of a check
# of models that are derived from others
_NOT_RECORDED: dict[str, Any] = {
    "condition": 0.0,
    "rounding_ratio": 0.0,
    "sign_changes": 0,
    "transfer_error": 0.0,
    "frequencies": (),
    "by_terms": (),
    "near": (),
}
NOTHING_FREE: dict[str, Any] = {
    name: () for name in ("accelerations", "momenta", "rigid_motions", "unmoved", "driven", "beside")
}


class Operation(NamedTuple):
    """What is done with parts: its name, and what it was asked for, as texts."""

    name: str
    asked: Mapping[str, Any] = {}


def check_exact(model: System, what: str) -> None:
    """Raise a StructureError for a truncated model: its guaranteed error would not be one any more."""
    if isinstance(model, LFTModel) and model.certificate.truncation_error > 0.0:
        raise StructureError(
            f"model {model.name!r}, {what}: the model is truncated, and the guaranteed bound of its "
            "error holds for its own inputs and outputs only. Start from the exact model and truncate "
            "the result."
        )


def composed(
    systems: Sequence[System],
    wiring: Wiring,
    inputs: Sequence[Signal],
    outputs: Sequence[Signal],
    operation: Operation,
    *,
    like: System | None = None,
    exchange: bool = False,
) -> System:
    """The whole of wired systems, reduced; an `LFTModel` if every one with parameters is.

    It takes its name and description from `like`, by default the first system, and the names of its
    states from the systems (`state_names`). `exchange` says that inputs and outputs of one system are
    exchanged, and nothing else: its bounds stay.
    """
    like = systems[0] if like is None else like
    what = f"model {like.name!r}, {operation.name}"
    parameters = merged_parameters(systems, what)
    wired = wire(systems, wiring, what)
    ways = (wired,) if exchange else (reduced(wired), wired)
    seed = next((p.certificate.seed for p in systems if isinstance(p, LFTModel)), _SEED)
    deltas = sampled_deltas(parameters, seed)
    lft, error, ratio = _checked(ways, systems, wiring, parameters, deltas, what)
    whole = (like.name, lft, state_names(systems), tuple(inputs), tuple(outputs), parameters)
    certified = [system for system in systems if isinstance(system, LFTModel)]
    if not certified or any(p.parameters and not isinstance(p, LFTModel) for p in systems):
        return System(*whole, description=like.description)
    if exchange:
        certificate = _in_other_coordinates(certified[0].certificate, error)
    else:  # every entry of the twin is moved by what may be wrong with it
        moved_systems = [
            replace(
                p,
                lft=moved(p.lft, _SEED, p.certificate.max_relative_error),
                certificate=replace(p.certificate, **NOTHING_FREE),
            )
            if isinstance(p, LFTModel) and p.lft.is_plain
            else p
            for p in systems
        ]
        twin = with_blocks(reduced(wire(moved_systems, wiring, what)), parameters.names)
        certificate = _certificate(certified, lft, twin, error, seed)
    ratio = max(ratio, *(system.certificate.rounding_ratio for system in certified))
    are_proved = all(system.certificate.well_posed == PROVED for system in certified)
    regularity = well_posed(lft, parameters, what, are_proved=are_proved)
    return LFTModel(
        *whole,
        description=like.description,
        trim=_trim(certified, parameters.names),
        certificate=replace(
            certificate, rounding_ratio=ratio, **free_motions(systems, wiring), **regularity
        ),
        provenance=_provenance(systems, certified[0].provenance, operation),
    )


def linked(
    systems: Sequence[System],
    links: tuple[Sequence[int], Sequence[int]],
    inputs: Sequence[int],
    outputs: Sequence[int],
    operation: Operation,
    *,
    gains: Sequence[float] | float = 1.0,
    like: System | None = None,
) -> System:
    """The whole of systems in which some inputs get outputs, times gains: `links` are pairs of positions.

    Positions count through the inputs, or the outputs, of all systems; `inputs` and `outputs` are those
    of the whole, and their names must differ.
    """
    wiring = plain_wiring(systems, len(inputs), len(outputs))
    wiring.Ky[links] = gains
    wiring.E[inputs, range(len(inputs))], wiring.F[range(len(outputs)), outputs] = 1.0, 1.0
    ends = {}
    for side, chosen in (("inputs", inputs), ("outputs", outputs)):
        every = [signal for system in systems for signal in getattr(system, side)]
        ends[side] = [every[k] for k in chosen]
        check_once([signal.name for signal in ends[side]], f"{operation.name}, {side}")
    return composed(systems, wiring, ends["inputs"], ends["outputs"], operation, like=like)


def merged_parameters(systems: Sequence[System], what: str) -> Parameters:
    """Parameters of all parts, sorted by name; those of equal names must be equal."""
    owners: dict[str, tuple[Parameter, System]] = {}
    for system in systems:
        for p in system.parameters:
            known, other = owners.setdefault(p.name, (p, system))
            if known != p:
                raise StructureError(
                    f"{what}: the parameter {p.name!r} of {system.name} is not that of "
                    f"{other.name}: {p} is not {known}. Rename one, or declare it once."
                )
    return Parameters(owners[name][0] for name in sorted(owners))


def state_names(systems: Sequence[System]) -> tuple[Signal, ...]:
    """States of all parts; those whose names stand twice are ``PART.STATE``, numbered if need be."""
    names = [state.name for system in systems for state in system.states]
    signals: list[Signal] = []
    used = {name for name in names if names.count(name) == 1}
    for system in systems:
        for state in system.states:
            name, k = state.name, 1
            if names.count(name) > 1:
                name = f"{system.name}.{state.name}"
                while name in used:
                    k += 1
                    name = f"{system.name}.{k}.{state.name}"
                used.add(name)
            signals.append(Signal(name, state.unit))
    return tuple(signals)


def _other_deltas(systems: Sequence[System], count: int) -> dict[str, Any]:
    """Random values (N) of the blocks that are not parameters, zero at the first point."""
    random = np.random.default_rng(_SEED)
    values: dict[str, Any] = {}
    for block in sorted({b for system in systems for b in system.lft.blocks if b.kind != "real"}):
        shape = (count, block.outputs, block.inputs) if block.kind == "full" else (count, 1, 1)
        value = random.standard_normal(shape) + 1j * random.standard_normal(shape)
        value *= _RADIUS / np.linalg.norm(value, 2, axis=(1, 2))[:, None, None]
        value[0] = 0.0
        values[block.name] = value if block.kind == "full" else value[:, 0, 0]
    return values


def values_of(lft: LFT, parameters: Parameters, deltas: Array, others: Mapping[str, Any]) -> Array:
    """Values (N, ., .) of an LFT at deltas (N, n_p) of parameters and at those of other blocks."""
    columns = {name: k for k, name in enumerate(parameters.names)}
    if all(block.kind == "real" for block in lft.blocks):
        return evaluate_at(lft, deltas[:, [columns[block.name] for block in lft.blocks]])
    return evaluate(
        lft,
        {b.name: deltas[:, columns[b.name]] if b.kind == "real" else others[b.name] for b in lft.blocks},
    )


def _checked(
    ways: Sequence[LFT],
    systems: Sequence[System],
    wiring: Wiring,
    parameters: Parameters,
    deltas: Array,
    what: str,
) -> tuple[LFT, float, float]:
    """The first LFT that has the values of the whole, with its errors (`_error`).

    A reduction in doubles may lose a direction: that of a range that is far to one side is small in the
    numbers of the channels, and not in values.
    """
    ratio = np.inf
    for way in ways:
        lft = with_blocks(way, parameters.names)
        if not lft.is_complex:  # the blocks that are not parameters are zero
            others = (block for block in lft.blocks if block.kind != "real")
            zero = {b.name: np.zeros((b.outputs, b.inputs) if b.kind == "full" else ()) for b in others}
            check_determinant(fix(lft, zero), deltas, what, parameters)
        error, ratio = _error(systems, wiring, lft, parameters, deltas, what)
        if ratio <= MOST_ROUNDINGS:
            return lft, error, ratio
    raise AnalysisError(
        f"{what}: the result differs from that of state-space formulas by {ratio:.1e} times what "
        f"rounding of all numbers may change, at most {MOST_ROUNDINGS:g} was expected. This is a "
        "bug: please report it."
    )


def _error(
    systems: Sequence[System], wiring: Wiring, lft: LFT, parameters: Parameters, deltas: Array, what: str
) -> tuple[float, float]:
    """Largest relative error of the whole, and that of its LFT in roundings.

    To the error of its LFT is added what those of the parts make of the whole.
    """
    others = _other_deltas(systems, len(deltas))
    values = [values_of(system.lft, parameters, deltas, others) for system in systems]
    errors = [p.certificate.max_relative_error if isinstance(p, LFTModel) else 0.0 for p in systems]
    try:
        sizes = [_sizes_of(s.lft, v, parameters, deltas) for s, v in zip(systems, values, strict=True)]
        reference = wired_values(systems, values, errors, sizes, wiring)
    except np.linalg.LinAlgError:
        raise WellPosednessError(f"{what}: the loop is singular at a checked point.") from None
    scale = entry_scale(reference.whole, reference.terms)
    values_of_lft = values_of(lft, parameters, deltas, others)
    differences = values_of_lft - reference.whole
    of_lft = _sizes_of(lft, values_of_lft, parameters, deltas)
    ratio = largest(differences, EPS * np.maximum(np.maximum(scale, reference.sizes), of_lft))
    return largest(differences, scale) + largest(reference.errors, scale), ratio


def _sizes_of(a: LFT, values: Array, parameters: Parameters, deltas: Array) -> Array:
    """What rounding of the entries of a part is relative to (., .): largest sizes at a few points."""
    largest_values: Array = np.max(np.abs(values), axis=0)
    if not a.is_plain or not a.blocks:
        return largest_values
    columns = {name: k for k, name in enumerate(parameters.names)}
    some = np.linspace(0, len(deltas) - 1, _LOOKED_AT).astype(int)
    at = deltas[some][:, [columns[block.name] for block in a.blocks]]
    return np.asarray(np.maximum(largest_values, np.max(rounding_sizes(a, at), axis=0)))


def _certificate(
    systems: Sequence[LFTModel], lft: LFT, twin: LFT, error: float, seed: int
) -> Certificate:
    order = {block.name: block.size for block in lft.blocks if block.kind == "real"}
    raw = dict.fromkeys(order, 0)
    for system in systems:
        for name, size in zip(system.parameters.names, system.certificate.raw_order, strict=True):
            raw[name] += size
    certificates = [system.certificate for system in systems]
    bounds = {}
    if not (lft.is_complex or twin.is_complex):
        bounds = degree_bounds(_at_generic(lft), moved(_at_generic(twin), seed), seed)
    lower = {name: min(bounds[name].degree, order[name]) if bounds else 0 for name in order}
    return Certificate(
        order=tuple(order.values()),
        lower_bound=tuple(lower.values()),
        raw_order=tuple(raw.values()),
        max_relative_error=error,
        check_points=min(
            (c.check_points for c in certificates if c.order), default=certificates[0].check_points
        ),
        seed=seed,
        exact=all(c.exact for c in certificates),
        doubtful=tuple(bounds[name].doubtful if bounds else order[name] for name in order),
        truncation_error=np.inf if any(c.truncation_error > 0.0 for c in certificates) else 0.0,
        fit_error_bound=max(c.fit_error_bound for c in certificates),
    )


def _at_generic(a: LFT) -> LFT:
    """The LFT in the parameters with the other blocks at one real value: it needs no more repetitions."""
    random, values = np.random.default_rng(_SEED), {}
    for block in a.blocks:
        if block.kind != "real":
            value = random.standard_normal(
                (block.outputs, block.inputs) if block.kind == "full" else (1, 1)
            )
            value *= _RADIUS / np.linalg.norm(value, 2)
            values[block.name] = value if block.kind == "full" else value[0, 0]
    return fix(a, values) if values else a


def _in_other_coordinates(certificate: Certificate, error: float) -> Certificate:
    """What a change of coordinates changes: the error, and what is not known any more."""
    return replace(certificate, max_relative_error=error, **_NOT_RECORDED)


def _trim(systems: Sequence[LFTModel], names: Sequence[str]) -> Trim:
    """The trims of all parts one after the other; without an LFT if that of one is not known."""
    held = [system for system in systems if system.trim.signals or system.trim.lft is not None]
    signals = [signal.name for system in held for signal in system.trim.signals]
    listed = tuple(
        replace(s, name=f"{system.name}.{s.name}") if signals.count(s.name) > 1 else s
        for system in held
        for s in system.trim.signals
    )
    nominal = tuple(value for system in held for value in system.trim.nominal)
    lfts = [system.trim.lft for system in held if system.trim.lft is not None]
    if not held or len(lfts) < len(held):
        return Trim(listed, nominal, None)
    return Trim(listed, nominal, with_blocks(stack_rows(*lfts), names))


def _provenance(systems: Sequence[System], first: Provenance, operation: Operation) -> Provenance:
    """The operation and the texts of its parts, as TOML; versions of what composed them."""
    lines = [f"operation = {_text(operation.name)}"]
    lines += [f"{key} = {_text(value)}" for key, value in operation.asked.items()]
    for system in systems:
        text = system.provenance.scene if isinstance(system, LFTModel) else repr(system)
        lines += ["", "[[parts]]", f"name = {_text(system.name)}", f"text = {_text(text)}"]
    return replace(
        first,
        scene="\n".join(lines) + "\n",
        mbdlft=version("mbdlft"),
        numpy=np.__version__,
        created=datetime.now(UTC).isoformat(timespec="seconds"),
    )


def _text(value: Any) -> str:
    """A TOML string, list of strings or number."""
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")


def opened_evidence(model: LFTModel, names: Sequence[str]) -> dict[str, Any]:
    """Trim and certificate of a model whose blocks of these names are signals of it.

    What is proved of the others stays: a smaller LFT of the opened model would give a smaller one of the
    model. The trim has no LFT if it depends on a parameter that left.
    """
    known = model.certificate
    kept = [k for k, p in enumerate(model.parameters) if p.name not in names]

    def of(entries: tuple[int, ...]) -> tuple[int, ...]:
        return tuple(entries[k] for k in kept) if entries else ()

    opened = sum(known.order) - sum(of(known.order))
    boxes = (tuple(box[k] for k in kept) for box in known.open_boxes)
    certificate = replace(
        known,
        open_boxes=tuple(dict.fromkeys(boxes)),
        order=of(known.order),
        lower_bound=of(known.lower_bound),
        raw_order=of(known.raw_order),
        doubtful=of(known.doubtful),
        order_bound=max(sum(of(known.lower_bound)), known.order_bound - opened),
        **NOTHING_FREE,
        **_NOT_RECORDED,  # of the entries of the opened model
    )
    lft = model.trim.lft
    if lft is None or any(block.size for block in lft.blocks if block.name in names):
        return {"certificate": certificate, "trim": replace(model.trim, lft=None)}
    trim_lft = replace(lft, blocks=tuple(block for block in lft.blocks if block.name not in names))
    return {"certificate": certificate, "trim": replace(model.trim, lft=trim_lft)}


def renormalized_evidence(model: LFTModel, lft: LFT, parameters: Parameters) -> Certificate:
    """That of a model with other ranges of its parameters: degrees are those of the old deltas.

    The error is that of the new LFT against the old one at points of the new range, and what is known
    of the old one, whose error is relative to the sizes of its entries in the old range.
    """
    certificate = model.certificate
    everywhere = sampled_deltas(model.parameters, certificate.seed)
    deltas = sampled_deltas(parameters, certificate.seed)
    columns = zip(model.parameters, parameters, deltas.T, strict=True)
    old = [to_delta(a, to_physical(b, column)) for a, b, column in columns]
    others = _other_deltas([model], len(deltas))
    reference = values_of(model.lft, model.parameters, np.stack(old or [np.zeros(1)], axis=1), others)
    sizes = np.max(np.abs(values_of(model.lft, model.parameters, everywhere, others)), axis=0)
    scale = entry_scale(reference, np.zeros(sizes.shape))
    lft_error = largest(values_of(lft, parameters, deltas, others) - reference, scale)
    error = lft_error + largest(certificate.max_relative_error * sizes, scale)
    what = f"model {model.name!r}, with_range"
    regularity = well_posed(lft, parameters, what, are_proved=certificate.well_posed == PROVED)
    return replace(_in_other_coordinates(certificate, error), **regularity)


def truncated_certificate(model: LFTModel, lft: LFT, error: float) -> Certificate:
    """That of a truncated model: not exact, with the guaranteed bound of its error [1]."""
    order = tuple(block.size for block in lft.blocks)
    truncated = replace(
        model.certificate, order=order, exact=False, truncation_error=error, **NOTHING_FREE
    )
    what = f"model {model.name!r}, truncate"
    return replace(
        truncated, **well_posed(lft, model.parameters, what, are_proved=truncated.well_posed == PROVED)
    )


_RANDOM, _MOST_CORNERS = 50, 64
_NEGLIGIBLE = 1e-8  # an entry below this part of its row and column is compared with them


def sampled_deltas(parameters: Sequence[Parameter], seed: int) -> Array:
    """Deltas (N, n_p) [1]: nominal, random points, and all corners, or as many random ones."""
    return deltas_at(parameters, check_points(parameters, seed, _RANDOM, _MOST_CORNERS))


def check_determinant(a: LFT, deltas: Array, what: str, parameters: Sequence[Parameter]) -> None:
    """Raise a WellPosednessError where I - M11 Delta is seen to be singular on the way to a point."""
    _, signs = values_at(a, deltas)
    singular = (signs <= 0.0) | vanishes(a, deltas)
    if np.any(singular):
        worst = deltas[int(np.argmax(singular))]
        where = ", ".join(f"{p.name}: {d:+.3g}" for p, d in zip(parameters, worst, strict=True))
        raise WellPosednessError(
            f"{what}: singular between the nominal values and the normalized ones {where}. Narrow the "
            "ranges."
        )


def entry_scale(reference: Array, terms: Array) -> Array:
    """What an entry of matrices (N, ., .) is compared with: its largest size over the points.

    An entry that is negligible in its row and column is compared with the smaller of the two, one that is
    negligible beside its own `terms` (., .) with them.
    """
    size = np.max(np.abs(reference), axis=0)
    rows = np.max(size, axis=1, initial=0.0, keepdims=True)
    columns = np.max(size, axis=0, initial=0.0, keepdims=True)
    whole = np.maximum(np.minimum(rows, columns), terms)
    scale = np.where(size > _NEGLIGIBLE * whole, size, whole)
    return np.where(scale > 0, scale, 1.0)
