"""From a scene to a certified LFT model: all stages in order, with the seconds of each."""

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from datetime import UTC, datetime
from functools import cache, partial
from importlib.metadata import version

import numpy as np

from mbdlft.base.errors import SceneError, WellPosednessError, unknown_name
from mbdlft.base.signal import Signal
from mbdlft.base.threads import one_thread
from mbdlft.bound.degree import degree_bounds, moved
from mbdlft.lft.lft import LFT, condition, eliminate, with_blocks
from mbdlft.multibody.assembly import assemble, assemble_by_products
from mbdlft.multibody.body import ElasticBody
from mbdlft.multibody.scene import NEEDED, Scene, scene_to_toml
from mbdlft.pipeline.certify import certificate, checked, measure_error
from mbdlft.pipeline.extract import extract
from mbdlft.pipeline.search import SEARCH, Budget, budget_of, find_smallest
from mbdlft.problem.equations import Equations
from mbdlft.problem.linearize import linearize, trim_relations
from mbdlft.problem.needed_states import Need, all_states, needed_states
from mbdlft.problem.trim import trim_efforts
from mbdlft.reduce.reduce import reduce_order
from mbdlft.system.model import LFTModel, Provenance, Trim
from mbdlft.system.truncation import check_tolerance
from mbdlft.system.truncation import truncate as truncated

SEED = 0
_LOSSY = 5e-15  # error of a model above which another way of reducing it is tried
_MOST_RETRIED = 200  # channels before reduction; for more it would take too long
_MOST_SEARCHED = 1000  # channels: one look at more takes minutes


@dataclass(frozen=True, slots=True)
class Build:
    """A model and the seconds of each stage that made it."""

    model: LFTModel
    seconds: dict[str, float]


@dataclass(slots=True)
class Clock:
    """Seconds by stage."""

    progress: Callable[[str], None]
    seconds: dict[str, float] = field(default_factory=dict)

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        self.progress(name)
        start = time.perf_counter()
        yield
        self.seconds[name] = time.perf_counter() - start


def to_lft(scene: Scene, search: float = SEARCH, *, seconds: float | None = None) -> LFTModel:
    """The exact linear model of a scene around its equilibrium, parameters left in, with certificate.

    Parameters
    ----------
    scene : Scene
    search : float
        Units of work, each about a second of one core, to look for a smaller model by using that
        parameters commute, and for a better lower bound by pairs and triples of parameters; it ends at
        once when the order meets the bound. 0: neither. Models of more than 1000 repetitions are not
        searched.
    seconds : float, optional
        Upper limit of the time of the search (s). Without one the result depends on the scene alone.

    Raises
    ------
    SceneError, NotRationalError, WellPosednessError, TrimError
        As the stages: `assemble`, `linearize`, `extract`, `certify`.
    """
    return build(scene, search, seconds=seconds).model


def build(
    scene: Scene,
    search: float = SEARCH,
    progress: Callable[[str], None] = lambda stage: None,
    truncate: float | None = None,
    seconds: float | None = None,
) -> Build:
    """As `to_lft`, with the seconds of each stage; `progress` is told the name of each as it starts.

    With a number for `truncate` the model is truncated to that tolerance [1], as by
    `mbdlft.truncate(model, tolerance)`.

    Linear algebra runs in one thread.
    """
    if not isinstance(scene, Scene):
        raise SceneError(
            f"expected a Scene, got {type(scene).__name__}. load_scene(path) reads one from a file."
        )
    budget = budget_of(search, seconds)  # before the work, not after it
    if truncate is not None:
        check_tolerance(truncate)
    with one_thread():
        clock = Clock(progress)
        model = _build(scene, budget, clock)
        if truncate is not None:
            with clock.stage("truncate"):
                model = truncated(model, truncate)
    return Build(model, clock.seconds | {"total": sum(clock.seconds.values())})


def _build(scene: Scene, budget: Budget, clock: Clock) -> LFTModel:
    with clock.stage("assemble"):
        equations, by_products = assemble(scene), assemble_by_products(scene)
        inputs, outputs = choose_signals(scene, equations)
    with clock.stage("trim"):
        trim = _trim(equations)
        assert trim.lft is not None
    with clock.stage("linearize"):
        need = choose_states(scene, equations, inputs, outputs)
    states = tuple(equations.x_signals[k] for k in need.states)
    with clock.stage("extract"):
        raw = extract(need.relations)
    solve = partial(_state_space, equations, states, len(outputs))
    names = [parameter.name for parameter in equations.parameters]

    def small(closed: LFT, *, extended: bool = False) -> LFT:
        return with_blocks(reduce_order(closed, extended=extended), names)

    def close(relations: LFT) -> LFT:
        return small(solve(relations))

    with clock.stage("reduce"):
        reduced = reduce_order(raw.lft)
        closed = solve(reduced)
        lft = small(closed)
        is_elastic = any(isinstance(body, ElasticBody) for body in scene.bodies)
        if is_elastic:
            # stiffnesses beside inertias: a reduction keeps more digits of M^-1 K than of M and K
            lft = min(close(raw.whole()), lft, key=lambda candidate: candidate.order)
    with clock.stage("bound"):
        # the error of the bound is that of the whole way from the relations on
        degrees = degree_bounds(lft, close(moved(reduced, SEED)), SEED)
        bound = {name: found.degree for name, found in degrees.items()}
    forms = [reduced]
    order_bound = sum(bound.values())
    if by_products is not None and order_bound < lft.order:
        with clock.stage("products"):
            extracted = extract(choose_states(scene, by_products, inputs, outputs).relations)
            forms.append(reduce_order(extracted.lft))
            other = close(forms[-1])
            if other.order < lft.order:
                raw, lft = extracted, other
    unsearched = lft
    if budget.work > 0.0 and order_bound < lft.order <= _MOST_SEARCHED:
        with clock.stage("search"):
            lft, order_bound, _ = find_smallest([lft], bound, budget, forms, close, closed)
    with clock.stage("check"):
        measure = partial(
            measure_error, equations, inputs, outputs, trim=trim.lft, seed=SEED, need=need
        )
        error, reference = measure(lft)
        retry = lft is unsearched and raw.order <= _MOST_RETRIED and not is_elastic
        if retry and error > _LOSSY:
            other = small(solve(raw.whole()), extended=True)
            if other.order <= lft.order:
                again, _ = measure(other, known=reference)
                lft, error = (other, again) if again < error else (lft, error)
        check = checked(equations, inputs, outputs, error, reference, need)
    return LFTModel(
        name=scene.name,
        lft=lft,
        states=states,
        inputs=tuple(equations.u_signals[k] for k in inputs),
        outputs=tuple(equations.y_signals[k] for k in outputs),
        parameters=equations.parameters,
        trim=trim,
        certificate=certificate(
            lft,
            raw.channels,
            degrees,
            order_bound,
            check,
            SEED,
            fit_error_bound=equations.fit_error_bound,
        ),
        provenance=provenance(scene_to_toml(scene)),
        description=scene.description,
    )


def _state_space(
    equations: Equations,
    states: Sequence[Signal],
    outputs: int,
    relations: LFT,
) -> LFT:
    """Close the relations for the unknown signals in the algebra: the LFT of [A B ; C D], not reduced."""
    # the relations come first; there are as many as unknowns
    n, nx = relations.shape[0] - outputs, len(states)
    try:
        solved = eliminate(relations, n)
    except WellPosednessError:
        directions = np.abs(np.linalg.svd(relations.M22[:n, :n])[2][-1])
        names = [s.name for s, size in zip(states, directions, strict=False) if size > 0.1]
        raise WellPosednessError(
            f"scene {equations.name!r}: the mass matrix is singular, or nearly so, at nominal (condition "
            f"number {condition(relations.M22[:n, :n]):.0e}, whatever the units): nothing with enough "
            f"inertia moves with {', '.join(names)}. Give what these joints carry a mass or an inertia, "
            "or the joints an actuator_inertia."
        ) from None
    rows = [*range(nx), *range(n, solved.shape[0])]
    return LFT(solved.M11, solved.M12, solved.M21[rows], solved.M22[rows], solved.blocks)


def _trim(equations: Equations) -> Trim:
    """Numbers at nominal from the nonlinear equations, and the static LFT from the relations."""
    relations = trim_relations(equations)
    lft = reduce_order(eliminate(extract(relations).lft, len(equations.unknown)))
    nominal = np.array([[parameter.nominal for parameter in equations.parameters]])
    efforts, _ = trim_efforts(equations, nominal)
    names = [parameter.name for parameter in equations.parameters]
    unknown = equations.unknown
    signals = tuple(equations.u_signals[k] for k in unknown)
    return Trim(signals, tuple(float(efforts[0, k]) for k in unknown), with_blocks(lft, names))


def choose_signals(scene: Scene, equations: Equations) -> tuple[list[int], list[int]]:
    """Positions of the inputs and outputs of a scene among the efforts and measures of its joints.

    Raises
    ------
    SceneError
        A name is unknown.
    """
    e = equations
    named = {e.u_signals[k].name: k for k in e.inputs}
    measured = {signal.name: k for k, signal in enumerate(e.y_signals)}
    return (
        _chosen(scene, "inputs", scene.inputs, named, e.default_inputs),
        _chosen(scene, "outputs", scene.outputs, measured, e.default_outputs),
    )


def choose_states(
    scene: Scene, equations: Equations, inputs: Sequence[int], outputs: Sequence[int]
) -> Need:
    """Linear relations of a scene with the states that it asks for."""
    relations = linearize(equations, inputs, outputs)
    choose = needed_states if scene.states == NEEDED else all_states
    return choose(relations, len(equations.states))


def _chosen(
    scene: Scene,
    what: str,
    names: tuple[str, ...] | None,
    index: Mapping[str, int],
    default: tuple[int, ...],
) -> list[int]:
    """Positions of the chosen signals, or the default."""
    for name in names or ():
        if name not in index:
            raise SceneError(
                f"scene {scene.name!r}, {what}: " + unknown_name("signal", name, index)
            )
    return list(default) if names is None else [index[name] for name in names]


@cache
def _version(package: str) -> str:
    return version(package)


def provenance(text: str) -> Provenance:
    """Versions, the time, and the TOML text that a model is made from."""
    return Provenance(
        scene=text,
        mbdlft=_version("mbdlft"),
        casadi=_version("casadi"),
        numpy=np.__version__,
        h5py=_version("h5py"),
        created=datetime.now(UTC).isoformat(timespec="seconds"),
    )
