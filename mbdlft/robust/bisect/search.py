"""What searches for bounds share: arguments, the bounds so far, two bisections over proofs, processes.

A search is a generator of states, none worse than the one before. Whoever runs it keeps the last, so it
may be interrupted at any time. Margins are proved from below: sizes of the box nearer and nearer to one
that is reached (`enlarged`). Gains and poles are proved from above: levels nearer and nearer to a value
that is reached (`lowered`).

A search gives its tasks in batches that do not depend on who computes them, this process, processes of
this machine, or a Dask cluster (`crew_of`), and gets results in the order of the tasks. So its answer
does not, either.
"""

from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from importlib import import_module
from math import prod, sqrt
from typing import Any, Generic, NamedTuple, TypeVar

import numpy as np

from mbdlft.base.array import Array
from mbdlft.base.errors import AnalysisError, WellPosednessError
from mbdlft.base.running import after, budget, one_thread
from mbdlft.base.worker import Pool, processes_of
from mbdlft.robust.bisect.boxes import Check, Crew, Outcome, Task, prove
from mbdlft.robust.bisect.characteristic import Polynomials, Realization, polynomials
from mbdlft.robust.bisect.lyapunov import Attempt, is_small, searched
from mbdlft.robust.evidence import Bounds as Bounds
from mbdlft.robust.evidence import BoxProof, LyapunovProof, Proof
from mbdlft.robust.realization import physical, shares
from mbdlft.system.model import System

UNSTABLE = (
    "the system is unstable at the worst case, a value inside the ranges; robust_stability says how much "
    "of the ranges is stable"
)
INTERRUPTED = "it was interrupted"
GAP, WORK, LARGEST = 0.01, 30.0, 100.0  # defaults: 1 %, half a minute, a hundred times the box
_SHARE, _AT_FIRST = 0.5, 0.35  # of the work that is left, for one target; while no size is proved
_SOON = 0.1  # of the work for a size, or as much as its coefficients: more is left to Lyapunov functions
_LOWER = 0.7  # a size that was not proved is approached from the proved one: this part of the way
_FAR = 4.0  # times the proved size, or the box: above it, the geometric mean comes next
_ABOUT_1 = 0.8  # sizes from this to one over it: the declared box is tried instead
_WIDER = 4.0  # factor of the distance of a level that resisted from the value that is reached
_MOST_COEFFICIENTS = 4e6  # of a polynomial in memory
_DEAR = 10.0  # units of work: above this a polynomial costs more than multipliers

Progress = Callable[[float, float], None]
Signals = tuple[tuple[str, ...], tuple[str, ...]]  # names of the inputs and outputs of a gain
NO_SIGNALS: Signals = ((), ())
Worst = TypeVar("Worst")
Made = TypeVar("Made")


def check_numbers(what: str, **numbers: float) -> None:
    """Raise an AnalysisError unless the gap is below 1 and all are positive and finite."""
    for name, value in numbers.items():
        most = 1.0 if name == "gap" else float("inf")
        if isinstance(value, bool) or not isinstance(value, int | float) or not 0.0 < value < most:
            raise AnalysisError(
                f"{what}: {name}: expected a number between 0 and {most:g}, got {value!r}."
            )


def alone(function: Callable[..., Any], task: Task) -> Any:
    """What a worker does."""
    with one_thread():
        return function(*task)


def by_itself(function: Callable[..., Any], tasks: Sequence[Task]) -> list[Any]:
    """The crew that is this process."""
    return [function(*task) for task in tasks]


@contextmanager
def crew_of(workers: int | None, client: Any, what: str) -> Iterator[Crew]:
    """What applies functions to tasks: `with crew_of(...) as crew`; two tasks start the processes."""
    if client is not None:
        try:
            import_module("distributed")  # an optional extra
        except ImportError:
            raise AnalysisError(f"{what}: a cluster needs Dask: pip install 'mbdlft[cluster]'.") from None
        yield lambda function, tasks: list(
            client.gather([client.submit(alone, function, task, pure=False) for task in tasks])
        )
        return
    count = processes_of(workers, what)
    pool: Pool | None = None
    with ExitStack() as stack:

        def by_processes(function: Callable[..., Any], tasks: Sequence[Task]) -> list[Any]:
            nonlocal pool
            if len(tasks) < 2 or count == 1:
                return by_itself(function, tasks)
            advice = "the analysis", "part of the box", "Take fewer workers."
            pool = pool or stack.enter_context(Pool(f"{__name__}:alone", count, advice))
            results = dict(pool.run({k: (function, task) for k, task in enumerate(tasks)}))
            return [results[k] for k in range(len(tasks))]

        yield by_processes


class Asked(NamedTuple):
    """What is asked for; arguments are those of `robust_stability`."""

    system: System
    gap: float
    work: float
    progress: Progress | None = None
    leave_out: tuple[str, ...] = ()
    largest: float = LARGEST
    crew: Crew = by_itself


class State(NamedTuple, Generic[Worst]):
    """The bounds so far: one is reached, the other is proved."""

    worst: Worst  # what reaches the one
    lower: float = 0.0
    upper: float = float("inf")
    proof: Proof | None = None  # of the other
    used: float = 0.0  # units of work
    reason: str = ""  # why no more is proved
    ended: bool = False  # whether no work would prove more
    later: tuple[float, float] = (0.0, 0.0)  # a size whose longest try waits for a proof of 1; its work

    def left(self, asked: Asked) -> float:
        """Units of work that are left."""
        return max(asked.work - self.used, 0.0)

    def share(self, asked: Asked) -> float:
        """Units of work for one size: less of what is left while nothing is proved."""
        return (_SHARE if self.lower else _AT_FIRST) * self.left(asked)

    def is_closed(self, asked: Asked) -> bool:
        """Whether the gap of a margin is not larger than what was asked for."""
        return self.lower >= min(self.upper, asked.largest) * (1.0 - asked.gap)

    def spent(self, asked: Asked) -> "State[Worst]":
        """The state when no work is left, with the reason."""
        reason = self.reason or f"the work of {asked.work:g} units was used up"
        return self._replace(reason=reason)


Search = Generator[State[Worst], None, State[Worst]]


def last_of(
    asked: Asked,
    start: State[Worst],
    search: Search[Worst],
    shown: Callable[[State[Worst]], tuple[float, float]] = lambda state: (state.lower, state.upper),
) -> State[Worst]:
    """The state when a search has ended, or was interrupted; `shown` are the bounds that a user sees."""
    state = start
    try:
        with budget(asked.work):
            while True:
                state = next(search)
                if asked.progress is not None:
                    asked.progress(*shown(state))
    except StopIteration as end:
        state = end.value
    except KeyboardInterrupt:
        state = state._replace(reason=INTERRUPTED)
    return state


def at_once(start: State[Worst], make: Callable[[], State[Worst]]) -> State[Worst]:
    """The state after a search without steps; the one before it, if it was interrupted."""
    try:
        return make()
    except KeyboardInterrupt:
        return start._replace(reason=INTERRUPTED)


def settled(make: Callable[[], Made]) -> Made:
    """What a short step at the end makes: Ctrl-C in it comes too late, and it is taken again."""
    try:
        return make()
    except KeyboardInterrupt:
        return make()


def enlarged(
    asked: Asked,
    state: State[Worst],
    tried: Callable[[State[Worst], float], State[Worst]],
    cost: float = 0.0,
    resisted: float = np.inf,
    into_gap: float = 0.5,
) -> Search[Worst]:
    """Prove sizes of the box nearer and nearer to `upper`; each costs at least so much work.

    `resisted` is the smallest size that was not proved. While none is, the declared box is next. Cuts of
    a larger one that wait for it are due when cuts have proved it, or the next size has resisted.
    """
    while not state.is_closed(asked):
        k = min(state.upper, asked.largest) * (1.0 - into_gap * asked.gap)
        is_due = isinstance(state.proof, BoxProof) or resisted < k
        if not (k < resisted or (k == state.later[0] and is_due)):
            k, least = state.lower + _LOWER * (resisted - state.lower), max(state.lower, 1.0)
            k = sqrt(least * resisted) if resisted > _FAR * least else k
            is_next = not state.lower or _ABOUT_1 < k < 1.0 / _ABOUT_1
            k = 1.0 if state.lower < 1.0 < resisted and is_next else k
        if state.used + cost > asked.work or not k > state.lower * (1.0 + 0.1 * asked.gap):
            return state.spent(asked)
        before, state = state, tried(state, k)
        if state.lower == before.lower and state.upper == before.upper:
            resisted = min(resisted, k)
        yield state
    return state


def lowered(
    asked: Asked,
    state: State[Worst],
    is_open: Callable[[State[Worst]], bool],
    level: Callable[[State[Worst], float], float],
    tried: Callable[[State[Worst], float], State[Worst]],
    cost: float = 0.0,
) -> Search[Worst]:
    """Prove upper bounds nearer and nearer to `lower`, which is reached; each costs so much work or more.

    `level` is a bound that is so many steps above what is reached.
    """
    steps = 1.0
    while is_open(state) and not state.ended:
        goal = level(state, steps)
        if goal >= state.upper or state.used + cost >= asked.work:
            return state.spent(asked)
        before, state = state, tried(state, goal)
        if state.ended:
            return state
        if state.upper < before.upper:
            steps = 1.0
        elif not state.lower > before.lower:
            steps *= _WIDER
        yield state
    return state


def expanded(
    state: State[Worst], model: Realization, k: float, ends: Array | None = None
) -> tuple[State[Worst], Polynomials | None]:
    """The polynomials on the box of size k; None, and a reason, if the model is singular in it.

    `ends` are those of the deltas, if not all are k.
    """
    state = state._replace(used=state.used + cost_of(model))
    try:
        return state, polynomials(model, k if ends is None else ends)
    except WellPosednessError as error:
        reason = str(error) if k == 1.0 else f"at {k:.4g} times the box {error}"
        return state._replace(reason=reason), None


def cut(
    asked: Asked,
    state: State[Worst],
    model: Realization,
    box: tuple[float | Array, Polynomials],
    is_wrong: Check,
    gain: float = 0.0,
    work: float | None = None,
) -> tuple[State[Worst], Outcome]:
    """What comes of a proof for a box of some size; half of the work that is left, if not told."""
    work = _SHARE * state.left(asked) if work is None else work
    with after(state.used):
        outcome = prove(model, *box, work, is_wrong, gain, asked.crew)
    return state._replace(used=state.used + outcome.work), outcome


def attempted(
    asked: Asked,
    state: State[Worst],
    model: Realization,
    box: tuple[float, Array, Polynomials],
    is_wrong: Check,
    work: float,
    gain: float = 0.0,
    longest: float = 0.0,
) -> tuple[State[Worst], Attempt]:
    """What comes of attempts to prove a region of poles, or a gain below 1/gain, on a box of some ends.

    The polynomial is exact near the border of stability. Where it is not enough soon, or was not for a
    smaller box, Lyapunov functions are tried before it, with the longest work if that is more. If only
    work was missing, no more is tried.
    While nothing is proved, the longest try of a size above 1 waits (`State.later`), 1 is tried in all
    ways, and what waits is given up if 1 is not proved, or cuts of a smaller box have had as much work.
    """
    k, ends, polynomials = box
    waiting, state = state.later, state._replace(later=(0.0, 0.0))
    tries, waits = [work], False  # of the polynomial; 0: Lyapunov functions
    if k == waiting[0]:
        tries = [waiting[1]]
    elif len(model.sizes) and not model.slope and is_small(model):
        soon = [] if isinstance(state.proof, LyapunovProof) else [max(_SOON * work, cost_of(model))]
        waits = k > 1.0 and not (state.lower or gain)
        tries = [*soon, 0.0] if gain or waits else [*soon, 0.0, 0.5 * work]
    for most in tries:
        if most:
            most = min(most, work)
            state, outcome = cut(asked, state, model, (ends, polynomials), is_wrong, gain, most)
            proof = None if outcome.log is None else BoxProof(outcome.log)
            state = state if proof else state._replace(reason=resistance(outcome, k, model, ends))
            if proof is None and k < waiting[0] and most >= waiting[1]:
                waiting = 0.0, 0.0
            center = outcome.open_box.center
            attempt = Attempt(proof, outcome.counterexample, center, outcome.work, is_hopeless=True)
        else:
            with after(state.used):
                attempt = searched(model, ends, max(work, longest), is_wrong, gain)
            state = state._replace(used=state.used + attempt.work)
        is_done = attempt.proof is not None or attempt.counterexample is not None
        if is_done or not (attempt.is_hopeless or (k < waiting[0] and not state.lower)):
            break
    if k < waiting[0] and (state.lower or attempt.proof is not None):
        later = waiting
    else:
        later = (k, 0.5 * work) if waits and attempt.is_hopeless and not is_done else state.later
    return state._replace(later=later), attempt


def bounds_of(
    asked: Asked,
    state: State[Any],
    kind: str,
    worst: tuple[Mapping[str, Any], float],
    changes: Array,
    reason: str,
    signals: Signals = NO_SIGNALS,
) -> Bounds:
    """The result with deltas of blocks and frequency of the worst case, and parts of its change."""
    system, (delta, frequency) = asked.system, worst
    names = [name for name in delta if name in system.parameters.names]
    values = np.array([float(delta[name]) for name in names])
    return Bounds(
        kind,
        state.lower,
        state.upper,
        physical(system, names, values) if names else {},
        delta,
        frequency,
        shares(list(delta), changes) if delta and np.any(changes) else {},
        state.used,
        reason,
        state.proof,
        asked.leave_out,
        inputs=signals[0],
        outputs=signals[1],
    )


def bounds_at(
    asked: Asked,
    state: State[Any],
    kind: str,
    model: Realization,
    worst: tuple[Array, float],
    slope: Array,
    reason: str,
    signals: Signals = NO_SIGNALS,
) -> Bounds:
    """The result with deltas, frequency and slope of the worst case, as far as these are known."""
    delta, frequency = worst
    is_known = len(delta) == len(model.names) and not np.isnan(frequency)
    by_name = dict(zip(model.names, delta.tolist(), strict=True)) if is_known else {}
    has_slope = len(slope) == len(delta) and bool(np.all(np.isfinite(slope)))
    changes = delta * slope if has_slope else np.zeros(len(delta))
    return bounds_of(asked, state, kind, (by_name, frequency), changes, reason, signals)


def cost_of(model: Realization) -> float:
    """Units of work of the Bernstein coefficients of a box."""
    nodes = prod(size + 1 for size in model.sizes) * (1 + model.J.size)
    return float(nodes * (6e-5 + 4e-7 * len(model.A) ** 3))


def is_dear(model: Realization, work: float) -> bool:
    """Whether a polynomial is too large, or costs more than multipliers, or than there is."""
    return bool(too_large(model)) or cost_of(model) > min(_DEAR, work)


def too_large(model: Realization) -> str:
    """Why a model cannot be proved this way, or nothing."""
    count = model.coefficients * (1 + model.J.size)
    if count <= _MOST_COEFFICIENTS:
        return ""
    return (
        f"the characteristic polynomial has {count:.2g} coefficients, more than the "
        f"{_MOST_COEFFICIENTS:.2g} that are carried"
    )


def resistance(outcome: Outcome, k: float, model: Realization, ends: Array | None = None) -> str:
    """What resisted a proof, and where; `ends` are those of the deltas, if not all are k."""
    box, sizes = outcome.open_box, np.broadcast_to(k if ends is None else ends, len(model.names))
    where = ", ".join(
        f"{name} in [{size * (c - h):.3g}, {size * (c + h):.3g}]"
        for name, size, c, h in zip(model.names, sizes, box.center, box.half, strict=True)
    )
    sought = (
        "a bound of the gain nor a point beyond it" if len(model.J) else "stability nor a point without"
    )
    return (
        f"at {k:.4g} times the box, cuts of the characteristic polynomial found neither {sought} with "
        f"this work for deltas {where}, near {outcome.frequency:.4g} rad/s"
    )
