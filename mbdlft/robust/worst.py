"""Worst cases over the box: of poles and disk margins with proved bounds; of other functions as searched.

The largest real part and the smallest damping of the poles are reached by following poles with exact
slopes, from the nominal point and from corners. That poles are left of a line, or of the edges of a
sector, is proved as stability is (`mbdlft.robust.bisect.boxes`), along the line or the edge in place of
the axis. Other functions are climbed with exact slopes, or with differences.
"""

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from mbdlft.base.arguments import arguments_checked
from mbdlft.base.array import Array
from mbdlft.base.errors import AnalysisError, WellPosednessError
from mbdlft.base.running import one_thread
from mbdlft.exact.rounding import eigenvalues_of, eigenvectors_of
from mbdlft.response.modes import spectrum
from mbdlft.response.norms import gramians
from mbdlft.robust import ascent
from mbdlft.robust.bisect import search
from mbdlft.robust.bisect.characteristic import Realization, is_stable_at
from mbdlft.robust.evidence import DAMPING, DISK, REAL_PART, Bounds, slope_of
from mbdlft.robust.gain import worst_case_gain
from mbdlft.robust.realization import (
    check_constant,
    left_out,
    moving_most,
    or_left_out,
    physical,
    realization,
    states_that_stay,
)
from mbdlft.system.algebra import feedback
from mbdlft.system.conversion import positions_of
from mbdlft.system.model import System

_SHARE = 0.7  # of the work that is left, for one edge
_MODES, _CORNERS, _MOST = 8, 8, 60  # searches from the nominal point, from corners; points of each
_NOTHING = 1e-6  # of the largest pole, or of a damping of 1: a gap need not be smaller
_INSIDE = 1.0 - 1e-15  # one over a bound is not above what was proved, however it was rounded
Function = Callable[[Array, Array, Array, Array], float]
POLES = {"real part": REAL_PART, "damping": DAMPING}
_NAMES = (*POLES, "disk margin", "H2 norm")
_STARTS = 8  # random corners from which a function is climbed
_DIFFERENCE = 1e-6  # of delta: small beside the box, and far above rounding
Value = Callable[[Realization, Array], tuple[float, Callable[[], Array]]]


class _Pole(NamedTuple):
    """The worst pole, and the deltas where it is."""

    pole: complex
    delta: Array


def _aim(kind: str) -> ascent.Aim:
    return ascent.UNDAMPED if kind == DAMPING else ascent.RIGHT


def _is_beyond(model: Realization, kind: str, goal: float, delta: Array) -> bool:
    return bool(np.max(_aim(kind).value(ascent.moving_at(model, delta)[0].poles)) >= goal)


def _looked(
    model: Realization, aim: ascent.Aim, state: search.State[_Pole], delta: Array
) -> tuple[search.State[_Pole], complex]:
    """The state with the worst pole at deltas, if none was worse; and this pole."""
    poles = ascent.moving_at(model, delta)[0].poles
    values = aim.value(poles)
    k = int(np.argmax(values))
    pole = complex(poles[k])
    if values[k] > state.lower:
        state = state._replace(lower=float(values[k]), worst=_Pole(pole, delta.copy()))
    return state, pole


def _pushed(
    model: Realization, aim: ascent.Aim, state: search.State[_Pole], delta: Array, pole: complex
) -> search.State[_Pole]:
    """The state after a search that pushes a pole from deltas."""
    return _looked(model, aim, state, ascent.push_right(model, delta, pole, _MOST, aim)[0])[0]


def _reached(model: Realization, aim: ascent.Aim) -> search.State[_Pole]:
    """Modes pushed from the nominal point, and the worst poles of corners."""
    q = len(model.sizes)
    state, _ = _looked(
        model, aim, search.State(_Pole(complex(np.nan), np.zeros(q)), -np.inf), np.zeros(q)
    )
    poles = ascent.moving_at(model, np.zeros(q))[0].poles
    kept = poles[poles.imag >= 0.0]
    order = np.argsort(-aim.value(kept), kind="stable")[:_MODES]
    starts = [(np.zeros(q), complex(kept[k])) for k in order]
    random = np.random.default_rng(0)
    for corner in np.sign(random.uniform(-1.0, 1.0, (_CORNERS if q else 0, q))):
        with suppress(WellPosednessError):
            state, pole = _looked(model, aim, state, corner)
            starts.append((corner, pole))
    for start, pole in starts:
        with suppress(WellPosednessError):
            state = _pushed(model, aim, state, start, pole)
    return state


def _edges(asked: search.Asked, model: Realization, kind: str) -> search.Search[_Pole]:
    """Bounds of the aim: its value at the worst pole so far, and the edge that is proved."""
    aim = _aim(kind)
    state = _reached(model, aim)
    yield state
    size = float(np.max(np.abs(eigenvalues_of(model.A)))) if aim is ascent.RIGHT else 1.0
    step = 0.5 * asked.gap * max(abs(state.lower), _NOTHING * size)
    reason = search.too_large(model)
    state = state._replace(reason=reason, ended=bool(reason))

    def is_open(state: search.State[_Pole]) -> bool:
        return state.upper - state.lower > 2.0 * step * (1.0 + 1e-9)

    def level(state: search.State[_Pole], steps: float) -> float:
        return state.lower + steps * step

    tried = partial(_behind, asked, model, kind)
    state = yield from search.lowered(asked, state, is_open, level, tried, search.cost_of(model))
    return state if is_open(state) else state._replace(reason="")


def _behind(
    asked: search.Asked, model: Realization, kind: str, state: search.State[_Pole], goal: float
) -> search.State[_Pole]:
    """The state after an attempt to prove that no pole is beyond an edge."""
    aim = _aim(kind)
    if aim is ascent.UNDAMPED and not -1.0 < goal < 0.0:
        why = (
            "a damping of 0 or less is not proved: a pole comes to the axis or beyond, or too near to "
            "tell; robust_stability says in how much of the ranges none does; no damping is below -1, "
            "that of an unstable real pole"
        )
        return state._replace(reason=why, ended=True)
    shift, slope = (goal, 0.0) if aim is ascent.RIGHT else (0.0, slope_of(-goal))
    region = model._replace(shift=shift, slope=slope)
    if not is_stable_at(region, np.zeros(len(model.sizes))):
        why = "the nominal poles are not proved to be left of the edge"
        return state._replace(reason=why, ended=True)
    state, polynomials = search.expanded(state, region, 1.0)
    if polynomials is None:
        return state._replace(ended=True)
    is_wrong, box = partial(_is_beyond, model, kind, goal), (1.0, np.ones(len(model.sizes)), polynomials)
    state, attempt = search.attempted(asked, state, region, box, is_wrong, _SHARE * state.left(asked))
    if attempt.proof is not None:
        return state._replace(proof=attempt.proof, upper=goal)
    if attempt.counterexample is not None:
        state, pole = _looked(model, aim, state, attempt.counterexample)
        return _pushed(model, aim, state, attempt.counterexample, pole)
    return state


def worst_poles(asked: search.Asked, model: Realization, kind: str) -> Bounds:
    """Bounds of the largest real part, or of the smallest damping."""
    if not len(model.A):
        raise AnalysisError(f"worst_case: model {asked.system.name!r} has no states, and no poles.")
    aim = _aim(kind)
    if aim is ascent.UNDAMPED and np.any(spectrum(model.A).at_zero):
        poles, _, shapes = eigenvectors_of(model.A)
        stay = states_that_stay(asked.system, asked.leave_out)
        names = moving_most(asked.system, stay, shapes[:, int(np.argmin(np.abs(poles)))])
        raise AnalysisError(
            f"worst_case: model {asked.system.name!r} has a pole at 0 at nominal, in which {names} move. "
            f"It has no damping ratio. Close a loop around it{or_left_out(asked.system)}."
        )

    def shown(state: search.State[_Pole]) -> tuple[float, float]:
        return (state.lower, state.upper) if aim is ascent.RIGHT else (-state.upper, -state.lower)

    start = search.State(_Pole(complex(np.nan), np.zeros(len(model.sizes))), -np.inf)
    state = search.last_of(asked, start, _edges(asked, model, kind), shown)
    pole, delta = state.worst
    moving = ascent.moving_at(model, delta)[0]
    k = int(np.argmin(np.abs(moving.poles - pole)))
    slope = aim.slope(complex(moving.poles[k]), moving.gradients[k])
    if aim is ascent.UNDAMPED:
        state = state._replace(lower=max(-state.upper, -1.0), upper=-state.lower)
    return search.bounds_at(asked, state, kind, model, (delta, abs(pole.imag)), slope, state.reason)


@arguments_checked
def worst_case(
    system: System,
    what: str | Function,
    inputs: Any = slice(None),
    outputs: Any = slice(None),
    *,
    gap: float = search.GAP,
    work: float = search.WORK,
    leave_out: Sequence[str] = (),
    progress: search.Progress | None = None,
    workers: int | None = 1,
    client: Any = None,
) -> Bounds:
    """The worst value of a property over the declared box, with a proved bound where there is one.

    Parameters
    ----------
    system : System or LFTModel
    what : {"real part", "damping", "disk margin", "H2 norm"}, or function
        The largest real part of a pole (rad/s); the smallest damping ratio; the smallest disk margin of
        the loop that u = r - y would close, 1/|I/2 - T|, T = L (I + L)^-1, in the H-infinity norm; the
        largest H2 norm; or the largest value of a function of A, B, C, D.
    inputs, outputs : name, number, slice, or list of these, optional
        Signals of the transfer; all, if not given. Poles are those of the system.
    gap, work, leave_out, progress, workers, client
        As for `robust_stability`; the gap of poles is relative to their real part or damping.

    Returns
    -------
    Bounds
        Of a real part, `upper` is proved and `lower` reached at `worst`; of a damping and a disk margin,
        `lower` is proved and `upper` reached. Of a norm or a function, `lower` is reached, and nothing is
        proved: `reason` says of how many points it is the largest.

    Source
    ------
    Disk margin: Seiler, Packard, Gahinet, IEEE Control Systems Magazine 40 (2020), of skew 0.
    """
    search.check_numbers("worst_case", gap=gap, work=work)
    check_constant(system, "worst_case")
    if what not in _NAMES if isinstance(what, str) else not callable(what):
        raise AnalysisError(
            f"worst_case: expected {', '.join(map(repr, _NAMES))} or a function, got {what!r}."
        )
    if what == "disk margin":
        disk = disk_transfer(system, inputs, outputs)
        more: dict[str, Any] = {"gap": gap, "work": work, "leave_out": leave_out}
        more |= {"workers": workers, "client": client}
        gain = worst_case_gain(disk, **more, progress=_inverted(progress))
        lower, upper = (1.0 / value if value else np.inf for value in (gain.upper, gain.lower))
        return replace(gain, kind=DISK, lower=lower * _INSIDE, upper=upper)
    j = positions_of(inputs, [s.name for s in system.inputs], "worst_case: inputs")
    i = positions_of(outputs, [s.name for s in system.outputs], "worst_case: outputs")
    with one_thread(), search.crew_of(workers, client, "worst_case") as crew:
        if isinstance(what, str) and what in POLES:
            leave_out = left_out(system, leave_out)
            asked = search.Asked(system, gap, work, progress, leave_out, crew=crew)
            return worst_poles(asked, realization(system, leave_out=leave_out), POLES[what])
        leave_out = left_out(system, leave_out, i)
        return _searched(system, realization(system, j, i, leave_out), what, leave_out)


@arguments_checked
def disk_transfer(system: System, inputs: Any = slice(None), outputs: Any = slice(None)) -> System:
    """I/2 - T of the loop that u = r - y closes: one over its H-infinity norm is the disk margin.

    Parameters
    ----------
    system : System or LFTModel
    inputs, outputs : name, number, slice, or list of these, optional
        Signals at which the loop is opened, as many of both; all, if not given.
    """
    loop = system[outputs, inputs]
    n = len(loop.inputs)
    if len(loop.outputs) != n:
        raise AnalysisError(
            f"disk margin of {system.name!r}: expected as many inputs as outputs, got {n} and "
            f"{len(loop.outputs)}. Choose the signals at which the loop is opened."
        )
    disk: System = 0.5 * np.eye(n) - feedback(loop, np.eye(n))
    return disk


def _inverted(progress: search.Progress | None) -> search.Progress | None:
    """What tells bounds of a disk margin, of those of a gain."""
    if progress is None:
        return None
    return lambda lower, upper: progress(1.0 / upper, 1.0 / lower if lower else np.inf)


def _searched(
    system: System, model: Realization, what: str | Function, leave_out: tuple[str, ...]
) -> Bounds:
    """The largest value that a search finds."""
    q = len(model.sizes)
    value = h2_and_slope if what == "H2 norm" else _by_differences(what)
    best, points = (-np.inf, np.zeros(q)), 0

    def look(delta: Array) -> tuple[float, Callable[[], Array]]:
        nonlocal best, points
        there, slope = value(model, delta)
        points += 1
        best = (there, delta.copy()) if there > best[0] else best
        return there / size, lambda: slope() / size

    size = 1.0
    first = look(np.zeros(q))[0]
    size = abs(first) if np.isfinite(first) and first else 1.0
    crossing = ascent.smallest_crossing(model, 1.0) if what == "H2 norm" else None
    if crossing is not None and np.isfinite(crossing.size):
        best = (np.inf, crossing.delta)
    random = np.random.default_rng(0)
    corners = np.sign(random.uniform(-1.0, 1.0, (_STARTS, q)))
    for start in (np.zeros(q), *corners) if q else ():
        if np.isfinite(best[0]):
            ascent.climb(look, 1.0, start)
    name = what if isinstance(what, str) else getattr(what, "__name__", "function")
    return Bounds(
        kind=f"worst-case {name}",
        lower=best[0],
        upper=np.inf,
        worst=physical(system, model.names, best[1]),
        delta=dict(zip(model.names, best[1].tolist(), strict=True)),
        frequency=np.nan,
        sensitivity={},
        work=0.0,
        reason=_why_infinite(model, best[1])
        if what == "H2 norm" and np.isinf(best[0])
        else f"checked, not proved: the largest of {points} values that a search looked at",
        leave_out=leave_out,
    )


def _why_infinite(model: Realization, delta: Array) -> str:
    """What makes an H2 norm infinite."""
    plant = ascent.at_delta(model, delta)
    return "the direct path D is not zero" if plant and np.any(plant.D) else search.UNSTABLE


def h2_and_slope(model: Realization, delta: Array) -> tuple[float, Callable[[], Array]]:
    """The H2 norm, infinite with a direct path or without stability, and its slope by the deltas.

    With the Gramians P, Q, h^2 = tr C P C' and d h^2 = 2 tr(Q dA P) + 2 tr(Q dB B') + 2 tr(dC P C').
    """
    plant = ascent.at_delta(model, delta)
    none = np.zeros(len(delta))
    if plant is None or np.any(plant.D):
        return np.inf, lambda: none
    A, B, C, _ = plant
    if not len(A):
        return 0.0, lambda: none
    if not np.max(eigenvalues_of(A).real) < 0.0:
        return np.inf, lambda: none
    P, Q = gramians(plant)
    value = float(np.sqrt(max(np.trace(C @ P @ C.T), 0.0)))

    def slope() -> Array:
        of_entries = np.block([[Q @ P, Q @ B], [C @ P, np.zeros((len(C), B.shape[1]))]])
        by_row = model.slopes(delta, np.eye(len(of_entries)), of_entries)
        return np.asarray(np.sum(by_row, axis=0) / max(value, 1e-300))

    return value, slope


def _by_differences(function: Any) -> Value:
    """The value of a function of A, B, C, D, and its slope by differences within the box."""

    def at(model: Realization, delta: Array) -> float:
        plant = ascent.at_delta(model, delta)
        if plant is None:
            return np.inf
        number = function(*plant)
        if not isinstance(number, int | float | np.number) or np.isnan(number):
            raise AnalysisError(
                f"worst_case: expected a number from {getattr(function, '__name__', function)!r}, got "
                f"{number!r} at deltas {', '.join(f'{d:.4g}' for d in delta)}."
            )
        return float(number)

    def value(model: Realization, delta: Array) -> tuple[float, Callable[[], Array]]:
        here = at(model, delta)

        def slope() -> Array:
            steps = np.where(delta > 0.0, -_DIFFERENCE, _DIFFERENCE)
            moved = [
                at(model, delta + step * e) for e, step in zip(np.eye(len(delta)), steps, strict=True)
            ]
            return np.asarray((np.array(moved) - here) / steps)

        return here, slope

    return value
