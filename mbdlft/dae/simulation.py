"""Simulation of DAEs and of their Delta-Theta form, with IDAS and CVODES of SUNDIALS through CasADi."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from mbdlft.base.arguments import arguments_checked
from mbdlft.base.array import Array, ArrayLike
from mbdlft.base.errors import AnalysisError, SceneError, check_known
from mbdlft.base.samples import physical_points
from mbdlft.base.unit import Signal
from mbdlft.dae.dae import Dae
from mbdlft.dae.index import blocks_of
from mbdlft.dae.newton import System, solve
from mbdlft.dae.structure import Structure, check_conditions, check_point, in_symbols, reduce_index
from mbdlft.dae.text import column_of, formula_function
from mbdlft.dae.to_problem import consistent_point
from mbdlft.multibody.motion.equations import equations_of_motion, moved_reference
from mbdlft.multibody.scene import Scene
from mbdlft.problem.equations import rows_of
from mbdlft.problem.sx.constants import in_doubles
from mbdlft.system.conversion import operand
from mbdlft.system.model import OUTSIDE, LFTModel
from mbdlft.system.model import System as LinearSystem
from mbdlft.system.sampled import matrices_at
from mbdlft.system.theta import ONE, DeltaThetaModel, theta_values

_DAE_ENDS = (
    "The solution may become infinite, the equations singular on the way, or the chosen states no states "
    "any more (choose others)."
)
_SCENE_ENDS = (
    "A ball may have made half a turn against a spring or between two times, where rotation vectors end "
    "(give more times), or a loop have come to a dead point."
)
_SINGULAR = 1e15  # condition of equations whose solution has no digit
TOLERANCE = 1e-13  # of the integrators, relative and absolute: 1e-12 loses 1e-8 of an energy in 10 s
_LARGEST = 1e100  # of inputs and states: from a torque of 1e300 CVODES does not move, and says nothing
# Adams' formulas keep the energy of what is not damped 30 times better than backward differences at the
# same cost; fast modes that are damped want the latter, which take over where these need so many steps
_METHODS = (("adams", 20_000), ("bdf", 1_000_000))


@dataclass(frozen=True, slots=True, eq=False)
class Simulation:
    """A simulation.

    Attributes
    ----------
    times : array (N,), s
    states : array (N, n_x)
    outputs : array (N, n_y)
    state_names, output_names : tuple of str
    """

    times: Array
    states: Array
    outputs: Array
    state_names: tuple[str, ...]
    output_names: tuple[str, ...]


@arguments_checked
def simulate(
    model: Scene | LFTModel | Dae | Structure | DeltaThetaModel,
    times: ArrayLike,
    *,
    inputs: Mapping[str, ArrayLike] | None = None,
    parameters: Mapping[str, float] | None = None,
    initial: Mapping[str, float] | None = None,
    controller: Any = None,
    tolerance: float = TOLERANCE,
) -> Simulation:
    """Integrate the equations over times.

    Those of a scene hold for motions of any size. Its states, inputs and outputs are deviations from the
    equilibrium, as in its linear model; the names of its states are those of all coordinates.

    Parameters
    ----------
    model : Scene, LFTModel, Dae, Structure or DeltaThetaModel
    times : array (N,), s
        Increasing; the first is the initial time.
    inputs : mapping of names to numbers or arrays (N,)
        Values are held from one time to the next; the others are zero.
    parameters : mapping of names to numbers, in their units
        The others are nominal.
    initial : mapping of names of states to numbers
        The others have consistent values near their start values.
    controller : System, or state space of python-control, optional
        From outputs of a scene to its inputs, by their names; what it commands is added to `inputs`. It
        has no parameters.
    tolerance : float
        Of the integrator, relative, and absolute in the units of the variables: signals that are far
        below 1 there need a smaller one.

    Raises
    ------
    SceneError
        A name or the times are not usable.
    AnalysisError, TrimError
        No consistent initial values in their ranges; the integrator stops; a function leaves its.
    """
    grid = np.asarray(times, dtype=float)
    if grid.ndim != 1 or len(grid) < 2 or not np.all(np.diff(grid) > 0) or grid[-1] == np.inf:
        raise SceneError("simulate: times are at least two increasing numbers.")
    model = reduce_index(model) if isinstance(model, Dae) else model
    asked = _Asked(grid, inputs or {}, parameters or {}, initial or {})
    for name, values in {**asked.inputs, **asked.states}.items():
        if not np.all(np.abs(np.asarray(values, dtype=float)) <= _LARGEST):
            raise SceneError(f"simulate: {name!r}: expected finite numbers, up to {_LARGEST:g}.")
    if isinstance(model, Scene | LFTModel):
        m = _scene(model, asked) if isinstance(model, Scene) else _linear(model, asked)
        m = m if controller is None else _closed_by(m, operand(controller, "simulate: controller"))
    elif controller is not None:
        raise SceneError("simulate: a controller closes a scene or model; write it into the equations.")
    else:
        m = _structure(model, asked) if isinstance(model, Structure) else _theta_form(model, asked)
    states, z, p = _integrated(m, grid, tolerance)
    kept = (m.y, m.omega, m.x if m.shown is None else m.shown)
    read = ca.Function("y", [m.x, m.z, m.u, m.p], [*map(ca.densify, kept)])
    values, arguments, states_shown = read.map(len(grid))(states.T, z.T, m.inputs.T, p.T)
    if isinstance(model, Structure):
        check_conditions(model, arguments.full(), grid)
    if isinstance(model, DeltaThetaModel):
        theta_values(model.functions, dict(zip(model.omega, arguments.full(), strict=True)))
    y, x = (np.asarray(each.full().T) for each in (values, states_shown))
    return Simulation(grid, x, y, m.state_names, m.output_names)


class _Asked(NamedTuple):
    """Times, and what is given by name: inputs at them, parameters, states at the first."""

    grid: Array
    inputs: Mapping[str, ArrayLike]
    parameters: Mapping[str, float]
    states: Mapping[str, float]


class _Model(NamedTuple):
    """der(x) = rates, 0 = residual, y: SX of x, z, u, p, with consistent values at the first time.

    `inputs` (N, n_u) are those at the times. `omega` are arguments of Theta, or conditions.
    """

    owner: str
    state_names: tuple[str, ...]
    output_names: tuple[str, ...]
    x: ca.SX
    z: ca.SX
    u: ca.SX
    p: ca.SX
    rates: ca.SX
    residual: ca.SX
    y: ca.SX
    omega: ca.SX
    inputs: Array
    x0: Array
    z0: Array
    p0: Array
    input_names: tuple[str, ...] = ()  # of what a controller can close
    is_linear: bool = False  # whether the residual is, in z: then it is solved at each step
    balls: tuple[int, ...] = ()  # positions in x of rotation vectors, whose references are p
    shown: ca.SX | None = None  # of x and u, as states of a result
    fit: Callable[[Array, Array], Array] | None = None  # of x, where inputs that jump move a loop


def _structure(s: Structure, asked: _Asked) -> _Model:
    where = f"{s.owner}, simulate"
    physical = physical_points(s.dae.parameters, asked.parameters, where, SceneError, slack=OUTSIDE)
    p = in_symbols(s.dae, physical)[0]
    inputs = _held(s.owner, [Signal(q.name, q.unit) for q in s.inputs], asked)
    at, n = consistent_point(s, p), s.unknown.numel()
    states = tuple(q.name for q in s.states)
    x0 = _initial(s.owner, states, at[n : n + len(states)], asked.states)
    sizes = np.array([q.variable.size for q in s.unknowns])
    system = System(s.residual, s.unknown, ca.vertcat(s.x, s.u, s.dae.p))
    start = solve(system, at[:n], np.concatenate([x0, inputs[0], p]), sizes)
    if not start.is_solution:
        worst = s.equations[int(np.argmax(start.missing))][0]
        raise AnalysisError(
            f"{s.owner}: no consistent initial values; equation {worst} does not hold. Give others."
        )
    check_point(s, np.concatenate([start.values, x0, inputs[0]]))
    read = (column_of(of.expression for of in each) for each in (s.dae.outputs, s.dae.conditions))
    values = map(in_doubles, (column_of(s.rates), s.residual, *read))
    symbols = (s.x, s.unknown, s.u, s.dae.p, *values, inputs, x0, start.values, p)
    return _Model(s.owner, states, tuple(y.name for y in s.dae.outputs), *symbols)


def _scene(scene: Scene, asked: _Asked) -> _Model:
    """The equations of motion of a scene, from values of its states; its other coordinates follow."""
    m, owner = equations_of_motion(scene, asked.parameters), f"scene {scene.name!r}"
    names = [signal.name for signal in m.coordinates]
    chosen, inputs = list(m.states), _held(owner, m.inputs, asked)
    still = np.tile([1.0, 0.0, 0.0, 0.0], len(m.balls))  # references: no rotation
    fit, x0 = None, np.zeros(len(names))
    x0[chosen] = _initial(owner, [names[k] for k in chosen], x0[chosen], asked.states)
    if m.followers:
        held = ca.vertcat(rows_of(m.x, chosen), m.u, m.references)
        system = System(m.constraints, rows_of(m.x, m.followers), held)
        fit = partial(_fitted, owner, system, chosen, list(m.followers))
        x0 = fit(x0, np.concatenate([inputs[0], still]))
        fit = fit if ca.depends_on(m.constraints, m.u) else None
    system = System(m.residual, m.z, ca.vertcat(m.x, m.u, m.references))
    at = np.concatenate([x0, inputs[0], still])
    z0 = np.zeros(m.z.numel())
    if not np.linalg.cond(system.jacobian(z0, at)) < _SINGULAR:
        raise AnalysisError(
            f"{owner}: masses and constraints do not determine the accelerations at the initial states; "
            "the matrix of these is singular to rounding. Give bodies inertias, or other initial states."
        )
    start = solve(system, z0, at, np.ones(len(z0)))
    outputs, commands = (tuple(signal.name for signal in each) for each in (m.outputs, m.inputs))
    symbols = (m.x, m.z, m.u, m.references, m.rates, m.residual, m.y, ca.SX(0, 1))
    values: Any = (inputs, x0, start.values, still, commands, True, m.balls, m.shown, fit)
    return _Model(owner, tuple(names), outputs, *symbols, *values)


def _fitted(
    owner: str, system: System, chosen: list[int], followers: list[int], x: Array, held: Array
) -> Array:
    """x with its followers where loops close, at inputs and references that are held."""
    closed = solve(system, x[followers], np.concatenate([x[chosen], held]), np.ones(len(followers)))
    if not closed.is_solution:
        raise AnalysisError(f"{owner}: its loops do not close at these initial states and inputs.")
    fitted = x.copy()
    fitted[followers] = closed.values
    return fitted


def _linear(model: LFTModel, asked: _Asked) -> _Model:
    """A linear model, which begins at zero."""
    owner, none = f"model {model.name!r}", ca.SX(0, 1)
    A, B, C, D = (ca.sparsify(ca.DM(matrix)) for matrix in matrices_at(model, asked.parameters))
    states, outputs, commands = (
        tuple(s.name for s in each) for each in (model.states, model.outputs, model.inputs)
    )
    x, u = ca.SX.sym("x", len(states)), ca.SX.sym("u", len(model.inputs))
    rates, y = ca.mtimes(A, x) + ca.mtimes(B, u), ca.mtimes(C, x) + ca.mtimes(D, u)
    inputs = _held(owner, model.inputs, asked)
    x0 = _initial(owner, states, np.zeros(len(states)), asked.states)
    values = (inputs, x0, np.zeros(0), np.zeros(0), commands)
    return _Model(owner, states, outputs, x, none, u, none, rates, none, y, none, *values)


def _closed_by(m: _Model, controller: LinearSystem) -> _Model:
    """The model with what a controller commands added to its inputs, and the states of the controller."""
    where = f"{m.owner}, controller"
    reads, commands = ([s.name for s in each] for each in (controller.inputs, controller.outputs))
    if len(controller.parameters):
        raise SceneError(
            f"{where}: expected no parameters, got {', '.join(controller.parameters.names)}."
        )
    check_known("output", reads, m.output_names, where)
    check_known("input", commands, m.input_names, where)
    read = rows_of(m.y, [m.output_names.index(name) for name in reads])
    if ca.depends_on(read, ca.vertcat(m.z, m.u)):
        raise SceneError(
            f"{where}: it reads accelerations, which depend on its command at once. Filter them first."
        )
    A, B, C, D = (ca.sparsify(ca.DM(matrix)) for matrix in matrices_at(controller, {}))
    own = ca.SX.sym("controller", A.shape[0])
    u = ca.SX(m.u)
    for name, size in zip(commands, ca.vertsplit(ca.mtimes(C, own) + ca.mtimes(D, read)), strict=True):
        u[m.input_names.index(name)] += size
    shown = m.x if m.shown is None else m.shown
    rates, residual, y, shown = ca.substitute([m.rates, m.residual, m.y, shown], [m.u], [u])
    return m._replace(
        state_names=(*m.state_names, *(s.name for s in controller.states)),
        x=ca.vertcat(m.x, own),
        rates=ca.vertcat(rates, ca.mtimes(A, own) + ca.mtimes(B, read)),
        residual=residual,
        y=y,
        shown=ca.vertcat(shown, own),
        x0=np.concatenate([m.x0, np.zeros(A.shape[0])]),
    )


def _theta_form(model: DeltaThetaModel, asked: _Asked) -> _Model:
    """The form with given states (the others at the start) and values of zeta that belong to them."""
    owner = f"model {model.name!r}"
    known = [p.name for p in model.linear.parameters]
    check_known("parameter", asked.parameters, known, f"{owner}, simulate")
    inputs = _held(owner, model.inputs, asked)
    states = tuple(s.name for s in model.linear.states)
    x0 = _initial(owner, states, np.array(model.initial or np.zeros(len(states))), asked.states)
    x, u = ca.SX.sym("x", len(states)), ca.SX.sym("u", len(model.inputs))
    zeta = ca.SX.sym("zeta", len(model.functions))
    rates, y, omega, theta = _closed(model, asked.parameters, x, u, zeta)
    start = np.array(model.zeta_at_start or np.zeros(zeta.numel()))
    system, knowns = System(zeta - theta, zeta, ca.vertcat(x, u)), np.concatenate([x0, inputs[0]])
    point = solve(system, start, knowns, np.maximum(np.abs(start), 1.0))
    if not point.is_solution:
        # functions of functions: as many evaluations as there are functions give all of them
        function, start = ca.Function("theta", [zeta, x, u], [ca.densify(theta)]), point.values
        for _ in model.functions:
            start = np.ravel(function(start, x0, inputs[0]).full())
        point = solve(system, start, knowns, np.maximum(np.abs(start), 1.0))
    if not point.is_solution:
        raise AnalysisError(
            f"{owner}: no consistent initial values of Theta were found. Give other initial states."
        )
    symbols = (x, zeta, u, ca.SX(0, 1), rates, zeta - theta, y, omega)
    output_names = tuple(y.name for y in model.outputs)
    return _Model(owner, states, output_names, *symbols, inputs, x0, point.values, np.zeros(0))


@arguments_checked
def evaluate_form(
    model: DeltaThetaModel,
    states: Mapping[str, float] | None = None,
    inputs: Mapping[str, float] | None = None,
    parameters: Mapping[str, float] | None = None,
) -> tuple[dict[str, float], dict[str, float]]:
    """Rates of the states and outputs of a Delta-Theta form, by their names.

    Parameters
    ----------
    model : DeltaThetaModel
    states, inputs, parameters : mappings of names to numbers, in their units
        The other states are those at the start, other inputs zero, other parameters nominal.
    """
    m = _theta_form(model, _Asked(np.zeros(1), inputs or {}, parameters or {}, states or {}))
    read = ca.Function("read", [m.x, m.u, m.z], [*map(ca.densify, (m.rates, m.y, m.omega))])
    values = [np.ravel(entry.full()).tolist() for entry in read(m.x0, m.inputs[0], m.z0)]
    theta_values(model.functions, dict(zip(model.omega, values[2], strict=True)))
    rates = dict(zip(m.state_names, values[0], strict=True))
    return rates, dict(zip(m.output_names, values[1], strict=True))


def _closed(
    model: DeltaThetaModel, parameters: Mapping[str, float], x: ca.SX, u: ca.SX, zeta: ca.SX
) -> tuple[ca.SX, ca.SX, ca.SX, ca.SX]:
    """Rates, outputs, omega and Theta(omega) at values of the parameters, as SX of x, u, zeta."""
    A, B, C, D = matrices_at(model.linear, parameters)
    every = {s.name: u[k] for k, s in enumerate(model.inputs)}
    every |= {ONE: ca.SX(1)} | {name: zeta[k] for k, name in enumerate(model.zeta)}
    v = column_of([every[s.name] for s in model.linear.inputs])
    rates = ca.mtimes(ca.sparsify(ca.DM(A)), x) + ca.mtimes(ca.sparsify(ca.DM(B)), v)
    read = ca.mtimes(ca.sparsify(ca.DM(C)), x) + ca.mtimes(ca.sparsify(ca.DM(D)), v)
    count = len(model.outputs)
    omega = {s.name: read[count + k] for k, s in enumerate(model.linear.outputs[count:])}
    values = [
        formula_function("theta", f.arguments, f.text, f.tables)(*(omega[name] for name in f.signals))
        for f in model.functions
    ]
    return rates, read[:count], column_of([omega[name] for name in model.omega]), column_of(values)


def _integrated(m: _Model, grid: Array, tolerance: float) -> tuple[Array, Array, Array]:
    """States (N, n_x), algebraic variables (N, n_z) and p (N, n_p) at the times."""
    if m.is_linear:
        return _with_solved(m, grid, tolerance)
    (rates, residual, of_z), kept = _explicit(m)
    z, held = column_of(m.z[k] for k in kept), ca.vertcat(m.u, m.p)
    dae = {"x": m.x, "p": held, "ode": ca.densify(rates)}
    dae |= {"z": z, "alg": ca.densify(residual)} if kept else {}
    system, run = System(residual, z, ca.vertcat(m.x, held)), _Integrator(m.owner, dae, tolerance)
    q = np.hstack([m.inputs, np.tile(m.p0, (len(grid), 1))])
    states, zs = np.zeros((len(grid), len(m.x0))), np.zeros((len(grid), len(kept)))
    states[0], zs[0] = m.x0, m.z0[kept]
    for start, end in _spans(m.inputs):
        run(grid[start : end + 1], states[start : end + 1], zs[start : end + 1], q[start])
        if kept:  # where inputs jump, the algebraic variables do, too
            knowns = np.concatenate([states[end], q[end]])
            point = solve(system, zs[end], knowns, np.maximum(np.abs(zs[end]), 1.0))
            if not point.is_solution:
                raise AnalysisError(f"{m.owner}: the equations have no solution at {grid[end]:g} s.")
            zs[end] = point.values
    function = ca.Function("z", [m.x, z, held], [ca.densify(of_z)])
    values = function.map(len(grid))(states.T, zs.T, q.T).full().T
    return states, values.reshape(len(grid), m.z.numel()), q[:, m.u.numel() :]


def _with_solved(m: _Model, grid: Array, tolerance: float) -> tuple[Array, Array, Array]:
    """The same where z solves linear equations: an ordinary differential equation for CVODES.

    References of rotation vectors follow at the times: nothing comes to half a turn between them.
    """
    held, z = ca.vertcat(m.u, m.p), m.z
    x, at = ca.MX.sym("x", m.x.numel()), ca.MX.sym("held", held.numel())
    right = -ca.substitute(m.residual, z, ca.SX.zeros(z.numel()))
    matrix, side = ca.Function("z", [m.x, held], [ca.jacobian(m.residual, z), right])(x, at)
    solved = ca.solve(matrix, side, "csparse")
    rates = ca.Function("rates", [m.x, z, held], [ca.densify(m.rates)])
    run = _Integrator(m.owner, {"x": x, "p": at, "ode": rates(x, solved, at)}, tolerance, _SCENE_ENDS)
    q = np.hstack([m.inputs, np.tile(m.p0, (len(grid), 1))])
    states, none = np.zeros((len(grid), len(m.x0))), np.zeros((len(grid), 0))
    states[0] = m.x0
    for start, end in _spans(m.inputs, every=bool(m.balls)):
        run(grid[start : end + 1], states[start : end + 1], none[start : end + 1], q[start])
        for k, ball in enumerate(m.balls):
            place = slice(m.u.numel() + 4 * k, m.u.numel() + 4 * k + 4)
            q[end:, place] = moved_reference(q[start, place], states[end, ball : ball + 3])
            states[end, ball : ball + 3] = 0.0
        if m.fit:
            states[end] = m.fit(states[end], q[end])
    zs = ca.Function("z", [x, at], [solved]).map(len(grid))(states.T, q.T).full().T
    return states, zs.reshape(len(grid), z.numel()), q[:, m.u.numel() :]


def _spans(inputs: Array, *, every: bool = False) -> Iterator[tuple[int, int]]:
    """The first and the last of the times between which inputs (N, n_u) are held, or of each step."""
    jumps = np.any(np.diff(inputs[:-1], axis=0), axis=1) | every
    ends = [*(np.flatnonzero(jumps) + 1).tolist(), len(inputs) - 1]
    return pairwise([0, *ends])


def _explicit(m: _Model) -> tuple[list[ca.SX], list[int]]:
    """Rates, residual and all z in those z that no single equation gives, and positions of these."""
    values: dict[int, ca.SX] = {}
    rows: list[ca.SX] = []
    kept: list[int] = []

    def known(expression: ca.SX) -> ca.SX:
        used = [s for s in ca.symvar(expression) if s.element_hash() in values]
        of_used = [values[s.element_hash()] for s in used]
        return ca.SX(ca.substitute(expression, column_of(used), column_of(of_used)))

    moving = ca.vertcat(m.x, m.z)
    for block in blocks_of(ca.jacobian_sparsity(m.residual, m.z)) if m.z.numel() else ():
        if len(block.rows) == 1:
            residual, symbol = known(m.residual[block.rows[0]]), m.z[block.columns[0]]
            slope = ca.jacobian(residual, symbol)
            if slope.nnz() and not ca.depends_on(slope, moving):
                values[symbol.element_hash()] = -ca.substitute(residual, symbol, ca.SX(0)) / slope
                continue
        rows += [known(m.residual[i]) for i in block.rows]
        kept += list(block.columns)
    return [known(m.rates), column_of(rows), known(ca.SX(m.z))], kept


class _Integrator:
    """Integrates from one time to others with inputs that are held."""

    def __init__(
        self, owner: str, dae: Mapping[str, Any], tolerance: float, hint: str = _DAE_ENDS
    ) -> None:
        none = {} if dae["x"].numel() else {"x": ca.SX.sym("none"), "ode": ca.SX(1, 1)}
        self.owner, self.dae, self.hint = owner, {**dae, **none}, hint
        self.options = {"abstol": tolerance, "reltol": tolerance}
        self.algebraic = "z" in dae
        self.methods = list(_METHODS[-1:] if self.algebraic else _METHODS)
        self._runs: dict[tuple[Any, ...], ca.Function] = {}

    def __call__(self, grid: Array, states: Array, zs: Array, p: Array) -> None:
        """Fill in states and algebraic variables at the times, of which those at the first are known."""
        steps = tuple((grid[1:] - grid[0]).round(14).tolist())
        arguments = {"p": p} | {name: v[0] for name, v in (("x0", states), ("z0", zs)) if v.size}
        while True:
            try:
                result = self._run(steps)(**arguments)
                break
            except RuntimeError as error:
                if len(self.methods) == 1:
                    raise AnalysisError(
                        f"{self.owner}: the integrator stopped: {str(error).splitlines()[-1]} {self.hint}"
                    ) from None
                self.methods.pop(0)
        for values, result_of in ((states, "xf"), (zs, "zf")):
            values[1:] = result[result_of].full().T[:, : values.shape[1]]
        if not np.all(np.isfinite(states)):
            raise AnalysisError(f"{self.owner}: the simulation does not stay finite.")

    def _run(self, steps: tuple[float, ...]) -> ca.Function:
        (method, most), kind = self.methods[0], "idas" if self.algebraic else "cvodes"
        if (method, steps) not in self._runs:
            of_kind: dict[str, Any] = {"suppress_algebraic": True}
            if not self.algebraic:
                of_kind = {"linear_multistep_method": method, "disable_internal_warnings": True}
            quiet = {"show_eval_warnings": False}  # a solution that ends made 600,000 lines
            options = {**self.options, "max_num_steps": most, **quiet, **of_kind}
            self._runs[method, steps] = ca.integrator("run", kind, self.dae, 0.0, list(steps), options)
        return self._runs[method, steps]


def _held(owner: str, signals: Sequence[Signal], asked: _Asked) -> Array:
    names = [s.name for s in signals]
    check_known("input", asked.inputs, names, f"{owner}, simulate")
    held = np.zeros((len(asked.grid), len(names)))
    for k, name in enumerate(names):
        values = np.asarray(asked.inputs.get(name, 0.0), dtype=float)
        if values.shape not in ((), asked.grid.shape):
            raise SceneError(
                f"{owner}, simulate: input {name!r} has shape {values.shape}, expected a number or "
                f"{asked.grid.shape}."
            )
        held[:, k] = values
    return held


def _initial(owner: str, names: Sequence[str], values: Array, initial: Mapping[str, float]) -> Array:
    check_known("state", initial, names, f"{owner}, simulate")
    return np.array([float(initial.get(name, x)) for name, x in zip(names, values, strict=True)])
