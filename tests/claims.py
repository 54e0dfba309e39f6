"""Analyses of all kinds, and changes of them that a check has to see."""

from collections.abc import Callable, Iterator
from dataclasses import fields, replace
from functools import cache
from typing import Any

import numpy as np

import mbdlft
from mbdlft import Bounds, ComplexBlock, Parameter, System, realize
from mbdlft.base.array import Array
from mbdlft.lft.lft import LFT
from mbdlft.robust import evidence
from mbdlft.robust.ascent import abscissa
from mbdlft.robust.realization import physical, realization
from mbdlft.synthesis import gain_goal, lpv_synthesis, pole_goal, tunable_gain, tune
from tests import kit

# the goal of a tuning, and whether the plant is chosen with the controller
TUNED = {"tuned": (0, False), "tuned poles": (1, False), "co-design": (0, True)}
UNCLAIMED = ("sensitivity", "work", "reason")  # what is said beside a claim, and nothing rests on
_FACTORS = (0.0, -1.0, 0.5, 0.9, 0.999, 1.001, 1.1, 2.0, 1e3, 1e-3, 1e300, np.nan, np.inf)
KINDS = (
    *("margin", "fixed", "moving", "slow", "mixed", "gain", "gain of one", "moving gain", "mixed gain"),
    *("performance", "real part", "damping", "disk margin", "double modes"),
    *("powers", "slow powers", "slow gain", "parts of a gain", "tuned", "tuned poles", "co-design"),
    "scheduled",
)


@cache
def cart() -> System:
    """A mass on a spring."""
    own = [Parameter("k", 2.0, low=1.6, high=2.4), Parameter("m", 1.0, low=0.9, high=1.1)]
    rows = "0 1 0 0; -k/m -1.4/m 1/m k; 1 0 0 0; 0 m 0 0.1"
    return kit.plant(rows, own, 2, "f g", "x v", name="cart")


@cache
def twice() -> System:
    """Two equal oscillators: Lyapunov functions prove more of them than the polynomial does."""
    own = [Parameter(name, 1.0, low=0.6, high=1.4) for name in ("k", "m")]
    return kit.plant("0 1 0 0; -k*m -0.01 0 0; 0 0 0 1; 0 0 -k*m -0.01", own, 4, name="twice")


@cache
def crossing() -> System:
    """Two oscillators in parallel whose frequencies cross."""
    own = [Parameter(name, 1.0, low=0.8, high=1.2) for name in ("a", "b")]
    rows = "0 0 1 0 0; 0 0 0 1 0; -a 0 -0.02 0 1; 0 -b 0 -0.02 1; 1 1 0 0 0"
    return kit.plant(rows, own, 4, "f", "x", name="crossing")


def swing(stiffness: str, damping: str) -> System:
    """An oscillator whose stiffness moves."""
    k = Parameter("k", 1.0, low=0.0, high=2.0)
    return realize([["0", "1"], [f"-{stiffness}", f"-{damping}"]], [k], states=2, inputs=[], outputs=[])


@cache
def tuned(*, designs: bool) -> mbdlft.Tuning:
    """x' = -a x + d + b u, u = -K x: K, and b or not, chosen for d to x and poles."""
    a, b = Parameter("a", 1.0, low=0.2, high=1.8), Parameter("b", 1.0, low=0.5, high=2.0, role="design")
    matrix = [["-a", "1", "b" if designs else "1"], ["1", "0", "0"]]
    plant = realize(
        matrix, [a, b][: 1 + designs], states=1, inputs=["d", "u"], outputs=["x"], name="plant"
    )
    K = tunable_gain("K", "x", "v", initial={"D[1,1]": -1.0}, ranges={"D[1,1]": (-5.0, 5.0)})
    goals = [gain_goal("d", "x", limit=0.2), pole_goal(decay=2.0)]
    return tune([plant, K], goals, [["x", "plant.x"], ["u", "v"]], starts=1, gap=0.1)


@cache
def scheduled() -> tuple[System, Bounds]:
    """x' = -a x + d + u, u scheduled by a: the loop of a synthesis, and its gain for any motion."""
    a = Parameter("a", 1.0, low=0.2, high=1.8, role="scheduled")
    plant = realize([["-a", "1", "1"], ["1", "0", "0"]], [a], states=1, inputs=["d", "u"], outputs=["x"])
    wired = [["x", "matrix.x"], ["u", "v"]]
    made = lpv_synthesis([plant, tunable_gain("K", "x", "v")], [gain_goal("d", "x")], wired, work=1.0)
    return made.loop, made.motion


def with_error(system: System) -> System:
    """The system from f to x with an uncertain gain of 0.3 in its input."""
    part: Any = system["x", "f"]
    one = np.ones((1, 1))
    lft = LFT(0.0 * one, one, 0.3 * one, one, (ComplexBlock("e", 1),))
    error = System("error", lft, (), part.inputs, part.inputs, mbdlft.Parameters(()))
    return mbdlft.series(error, part)


@cache
def analysis(kind: str) -> tuple[System, Bounds]:
    """One analysis of the kind, with its system."""
    plant = cart()
    one: Any = plant["x", "f"]
    mixed, weighted, fast = with_error(plant), 0.2 * plant, {"k": np.inf}
    closed = mbdlft.as_system(mbdlft.feedback(mixed, np.ones((1, 1))))
    made: dict[str, tuple[System, Callable[[System], Bounds]]] = {
        "margin": (plant, mbdlft.robust_stability),
        "fixed": (plant, lambda s: mbdlft.robust_stability(s, fixed=["m"], gap=0.05)),
        "moving": (plant, lambda s: mbdlft.robust_stability(s, rates=fast, gap=0.3, work=3.0)),
        "slow": (plant, lambda s: mbdlft.robust_stability(s, rates={"k": 0.5}, gap=0.3, work=3.0)),
        "mixed": (closed, lambda s: mbdlft.robust_stability(s, gap=0.1)),
        "gain": (plant, lambda s: mbdlft.worst_case_gain(s, gap=0.05)),
        "gain of one": (plant, lambda s: mbdlft.worst_case_gain(s, "f", "x", gap=0.05)),
        "moving gain": (plant, lambda s: mbdlft.worst_case_gain(s, "f", "x", rates=fast, gap=0.3)),
        "mixed gain": (mixed, lambda s: mbdlft.worst_case_gain(s, gap=0.1)),
        "performance": (weighted, lambda s: mbdlft.robust_performance(s, gap=0.1)),
        "disk margin": (one, lambda s: mbdlft.worst_case(s, kind, gap=0.05)),
        "double modes": (twice(), lambda s: mbdlft.robust_stability(s, gap=0.5, work=1.0)),
        "powers": (
            swing("2-k", "1"),
            lambda s: mbdlft.robust_stability(s, rates=fast, gap=0.3, work=9.0),
        ),
        "slow powers": (
            swing("k", "0.02"),
            lambda s: mbdlft.robust_stability(s, rates={"k": 0.04}, gap=0.5),
        ),
        "slow gain": (plant, lambda s: mbdlft.worst_case_gain(s, "f", "x", rates={"k": 0.5}, gap=0.5)),
        "parts of a gain": (crossing(), lambda s: mbdlft.worst_case_gain(s, gap=0.95, work=1.0)),
    }
    if kind == "scheduled":
        return scheduled()
    for name, (goal, designs) in TUNED.items():
        if name == kind:
            reached = tuned(designs=designs).goals[goal]
            return reached.loop, reached.bounds[0]
    system, bounds_of = made.get(kind, (plant, lambda s: mbdlft.worst_case(s, kind, gap=0.05)))
    return system, bounds_of(system)


def changed(bounds: Bounds, random: np.random.Generator) -> tuple[Bounds, str]:
    """The analysis with one field changed, of its proof half of the times; and which."""
    proof: Any = bounds.proof
    names = [field.name for field in fields(Bounds) if field.name not in (*UNCLAIMED, "proof")]
    inner = [field.name for field in fields(proof)]
    if random.uniform() < 0.5:
        name = str(random.choice(inner))
        new = replace(proof, **{name: _other(name, getattr(proof, name), random)})
        return replace(bounds, proof=new), f"proof.{name}"
    name = str(random.choice(names))
    return replace(bounds, **{name: _other(name, getattr(bounds, name), random)}), name


def _other(name: str, value: Any, random: np.random.Generator) -> Any:
    """Another value of a field of its kind."""
    if name == "kind":
        return str(random.choice([kind for kind in evidence.SENTENCES if kind != value]))
    if name == "log":
        return _log(value, random)
    if name == "rates":
        return random.choice([{}, {"k": np.inf, "m": np.inf}, {"m": 0.1}, {"k": 1e-3}])  # type: ignore[arg-type]
    if name in ("inputs", "outputs", "fixed", "leave_out"):
        known = {"inputs": ("f", "g"), "outputs": ("x", "v"), "fixed": ("k", "m", "e")}
        pool = known.get(name, ("x1", "x2", "x3"))
        return tuple(str(word) for word in random.permutation(pool)[: random.integers(0, 3)])
    if isinstance(value, float):
        return value * factor_of(random)
    if isinstance(value, int):
        return value + int(random.choice([-2, -1, 1, 2, 10**9]))
    if isinstance(value, dict):
        return _mapping(value, random)
    if isinstance(value, np.ndarray):
        return _array(value, random)
    if name == "intervals":
        return _item(value, lambda i: evidence.Interval(*_array(np.array(i), random).tolist()), random)
    if name == "multipliers":
        return _item(value, lambda m: _multipliers(m, random), random)
    return np.ones((4, 3)) if value is None else value


def factor_of(random: np.random.Generator) -> float:
    """A factor, or a last bit."""
    return float(random.choice([*_FACTORS, 1.0 + 2.0**-52, 1.0 - 2.0**-53]))


def _log(log: tuple[int, ...], random: np.random.Generator) -> tuple[int, ...]:
    way, k = random.integers(0, 4), int(random.integers(0, max(1, len(log))))
    if way == 0:
        return log[:k]
    if way == 1:
        return (*log[:k], int(random.integers(0, 10)), *log[k:])
    if way == 2:
        return (0,)
    return tuple(x + int(random.choice([-1, 1, 3])) * (i == k) for i, x in enumerate(log))


def _mapping(values: dict[str, Any], random: np.random.Generator) -> dict[str, Any]:
    if not values or random.uniform() < 0.2:
        return {} if values else {"k": 1.0}
    name = str(random.choice(list(values)))
    factor = factor_of(random)
    with np.errstate(all="ignore"):
        return {**values, name: values[name] * factor}


def _array(array: Array, random: np.random.Generator) -> Array:
    """An array with one entry changed, or one row less."""
    other = array.copy()
    if len(array) and random.uniform() < 0.2:
        return other[:-1] if array.ndim > 1 else other * 2.0
    if other.size and other.dtype.kind == "i":
        other.flat[random.integers(0, other.size)] += random.choice([-3, -1, 1, 2])
    elif other.size:
        with np.errstate(all="ignore"):
            other.flat[random.integers(0, other.size)] *= factor_of(random)
    return other


def _multipliers(multipliers: evidence.Multipliers, random: np.random.Generator) -> evidence.Multipliers:
    """Other ones: a matrix with an entry and its conjugate changed, or one row and column less."""
    name = str(random.choice(["D", "G"]))
    matrix = getattr(multipliers, name).copy()
    if random.uniform() < 0.2:
        return multipliers._replace(D=multipliers.D[:-1, :-1], G=multipliers.G[:-1, :-1])
    if random.uniform() < 0.1:
        return multipliers._replace(beta=factor_of(random))
    i, j = random.integers(0, len(matrix), 2)
    with np.errstate(all="ignore"):
        matrix[i, j] *= factor_of(random)
    matrix[j, i] = np.conj(matrix[i, j])
    return multipliers._replace(**{name: matrix})


def _item(items: tuple[Any, ...], change: Any, random: np.random.Generator) -> tuple[Any, ...]:
    k = int(random.integers(0, len(items)))
    if random.uniform() < 0.2:
        return items[:k] + items[k + 1 :]
    return (*items[:k], change(items[k]), *items[k + 1 :])


def is_true(system: System, other: Bounds, fresh: Bounds) -> bool:
    """Whether an accepted claim is true: beside a fresh run, or at samples of the box."""
    claim, before = other.claim, fresh.claim
    same = replace(claim, bound=0.0) == replace(before, bound=0.0)
    if same:
        is_weaker = claim.bound >= before.bound if fresh.is_from_above else claim.bound <= before.bound
        return is_weaker or fresh.lower <= claim.bound <= fresh.upper
    return at_samples(system, other)


def at_samples(system: System, bounds: Bounds) -> bool:
    """Whether no sample of the box passes the bound; parameters are constant there."""
    claim, random = bounds.claim, np.random.default_rng(0)
    deltas = random.uniform(-1.0, 1.0, (400, len(system.parameters)))
    deltas[:200] = np.sign(deltas[:200])
    system = _on_box(
        system, {b.name: 1.0 if b.name in claim.fixed else claim.size for b in system.lft.blocks}
    )
    values = {p.name: _physical(p, deltas[:, k]) for k, p in enumerate(system.parameters)}
    part: Any = system[list(claim.outputs), list(claim.inputs)] if claim.outputs else system
    A, B, C, D = mbdlft.matrices_at(part, values)
    poles = np.linalg.eigvals(A)
    if claim.kind == "largest real part":
        return bool(np.max(poles.real) <= claim.bound)
    if claim.kind == "smallest damping":
        return bool(np.min(-poles.real / np.abs(poles)) >= claim.bound)
    if np.max(poles.real) >= 0.0:
        return False
    if claim.kind == "robust stability":
        return True
    s = 1j * np.geomspace(1e-2, 1e2, 400)[None, :, None, None]
    eye = np.eye(A.shape[1])
    G = C[:, None] @ np.linalg.solve(s * eye - A[:, None], B[:, None] + 0j) + D[:, None]
    if claim.kind == "smallest disk margin":
        one = np.eye(G.shape[-1])
        G = 0.5 * one - G @ np.linalg.inv(one + G)
    gain = float(np.max(np.linalg.svd(G, compute_uv=False)))
    return gain * claim.gain <= 1.0 + 1e-9


def _on_box(system: System, sizes: dict[str, float]) -> System:
    """The system whose deltas in [-1, 1] are those of blocks of these sizes: z is as much larger."""
    lft = system.lft
    factors = np.concatenate([np.zeros(0), *(np.full(b.inputs, sizes[b.name]) for b in lft.blocks)])[
        :, None
    ]
    larger = LFT(factors * lft.M11, factors * lft.M12, lft.M21, lft.M22, lft.blocks)
    signals = system.states, system.inputs, system.outputs
    return System(system.name, larger, *signals, system.parameters)


def _physical(p: Parameter, deltas: Array) -> Array:
    from mbdlft.base.parameter import to_physical

    return np.array([to_physical(p, delta) for delta in deltas])


def forged(bounds: Bounds) -> Iterator[tuple[str, Bounds]]:
    """Analyses that claim what is not proved, by name; none may be accepted."""
    better = 0.5 * (bounds.lower + bounds.upper)
    is_closed = bounds.is_from_above
    for step in (1e-3, 0.5, 1.0, 10.0):
        width = bounds.upper - bounds.lower
        if is_closed:
            yield f"upper {step}", replace(bounds, upper=bounds.lower - step * abs(width))
        else:
            yield f"lower {step}", replace(bounds, lower=bounds.upper + step * abs(width))
    yield "lower above upper", replace(bounds, lower=bounds.upper * 1.1 + 1.0)
    yield "not a number", replace(bounds, lower=np.nan)
    yield "no proof", replace(bounds, proof=None)
    yield "no signals, or some", replace(bounds, inputs=() if bounds.inputs else ("f",), outputs=())
    for kind in evidence.SENTENCES:
        if kind != bounds.kind:
            size = 1e-3 if kind == "worst-case gain" else 1e3
            yield (
                kind,
                replace(bounds, kind=kind, lower=0.1 * size * abs(better), upper=size * abs(better)),
            )
    if bounds.delta and bounds.motion is None:
        zero = {name: 0.0 * np.asarray(d) for name, d in bounds.delta.items()}
        nominal = {name: x[()] if x.ndim == 0 else x for name, x in zero.items()}
        yield "the worst case is nominal", replace(bounds, delta=nominal)
        wide = {name: 3.0 * d for name, d in bounds.delta.items()}
        yield "the worst case is outside", replace(bounds, delta=wide)
        yield "nothing is the worst case", replace(bounds, delta={})
    if not bounds.rates:
        yield "moving", replace(bounds, rates={"k": np.inf})
    else:
        yield "constant", replace(bounds, rates={})
    proof = bounds.proof
    if isinstance(proof, evidence.BoxProof):
        yield "no cuts", replace(bounds, proof=evidence.BoxProof(()))
    elif isinstance(proof, evidence.IntervalProof):
        small = tuple(m._replace(D=m.D[:1, :1], G=m.G[:1, :1]) for m in proof.multipliers)
        yield (
            "multipliers that are too small",
            replace(bounds, proof=replace(proof, multipliers=small[:0])),
        )
        yield "multipliers of one channel", replace(bounds, proof=replace(proof, multipliers=small))
    elif isinstance(proof, evidence.MotionProof):
        yield "no form", replace(bounds, proof=replace(proof, P=0.0 * proof.P))
    elif isinstance(proof, evidence.PolynomialProof):
        yield "no function", replace(bounds, proof=replace(proof, V=0.0 * proof.V))
    elif isinstance(proof, evidence.LyapunovProof):
        whole = replace(proof, log=(0,), states=proof.states[:1])
        yield "one function", replace(bounds, proof=whole)
        yield "no functions", replace(bounds, proof=replace(proof, states=0.0 * proof.states))


def misstated(system: System, bounds: Bounds) -> Iterator[tuple[str, Bounds]]:
    """Analyses whose worst case is wrong in one respect only, by name; none may be accepted."""
    is_margin = bounds.kind == "robust stability"
    if bounds.motion is not None:
        yield "half of the motion", _shrunk(system, bounds)
        return
    if not bounds.delta:
        return
    nothing = {"lower": 0.0} if bounds.is_from_above else {"upper": np.inf}
    yield "values that reach nothing", replace(bounds, delta={}, **nothing)
    yield "a delta of no block", replace(bounds, delta={**bounds.delta, "none": 0.0})
    for name, value in bounds.worst.items():
        yield "another value", replace(bounds, worst={**bounds.worst, name: 1.01 * value + 0.01})
    if is_margin:
        yield "a larger size", replace(bounds, upper=2.0 * bounds.upper)
        yield "half of the size", _shrunk(system, bounds)
        if not _is_complex(bounds.delta):
            other = bounds.frequency * 1.2 + 1.0 if np.isfinite(bounds.frequency) else 1.0
            yield "another frequency", replace(bounds, frequency=other)
    if bounds.kind == "largest real part":
        names, there = list(bounds.worst), -1.5 * np.array([bounds.delta[n] for n in bounds.worst])
        reached = abscissa(realization(system, leave_out=bounds.leave_out), there)
        assert reached < bounds.upper
        outside = replace(bounds, delta=dict(zip(names, there.tolist(), strict=True)), lower=reached)
        yield "a point outside", replace(outside, worst=physical(system, names, there))
    if bounds.kind == "worst-case gain":
        yield "less than is reached", replace(bounds, lower=0.5 * bounds.lower)
        upper = max(bounds.upper, 1.1 * bounds.lower)
        yield "more than is reached", replace(bounds, lower=1.05 * bounds.lower, upper=upper)


def _shrunk(system: System, bounds: Bounds) -> Bounds:
    """The same with half of its deltas, as if these reached the border of stability."""
    delta = {name: 0.5 * value for name, value in bounds.delta.items()}
    names = list(bounds.worst)
    worst = physical(system, names, np.array([delta[name] for name in names])) if names else {}
    motion = bounds.motion
    if motion is not None:
        motion = np.hstack([motion[:, :1], 0.5 * motion[:, 1:]])
    upper = 0.5 * bounds.upper
    frequency = bounds.frequency if motion is not None or _is_complex(delta) else np.inf
    lower = min(bounds.lower, upper)
    return replace(
        bounds, delta=delta, worst=worst, motion=motion, upper=upper, lower=lower, frequency=frequency
    )


def _is_complex(delta: dict[str, Any]) -> bool:
    return any(np.iscomplexobj(value) for value in delta.values())
