"""From a scene to the problem that the pipeline solves, and facts that its user may have overlooked."""

from collections.abc import Mapping, Sequence
from contextlib import nullcontext
from functools import partial

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from mbdlft.base.arguments import arguments_checked
from mbdlft.base.errors import SceneError, unknown_name
from mbdlft.base.samples import SEED, check_points
from mbdlft.base.unit import Signal
from mbdlft.exact.modular import solved
from mbdlft.multibody.assembly import Assembly, assemble, assembly
from mbdlft.multibody.assembly.coupled import multipliers_of, rigid
from mbdlft.multibody.body import Beam
from mbdlft.multibody.body.beam import error_sentence
from mbdlft.multibody.force import Spring
from mbdlft.multibody.scene import NEEDED, Scene, scene_to_toml
from mbdlft.multibody.scene.checks import weightless
from mbdlft.multibody.scene.quantities import unused_names, unused_ports
from mbdlft.problem.equations import Equations
from mbdlft.problem.needs import Need, all_states, felt_inputs, needed_states, without_free_modes
from mbdlft.problem.references import reference_of
from mbdlft.problem.relations import Form, Nouns, Problem, Stage, TrimRelations, linearize, trim_relations
from mbdlft.problem.sx.constants import modulo_prime
from mbdlft.problem.trim import solve_trim, trim_efforts

_SEED = 20261124  # of the residues that stand for parameters
_MOST_FREEDOMS = 250  # of joints: 200 take two minutes and 1.2 GB
_NOTHING = 1e-9  # of the largest effort in its unit, or of 1 N or 1 N m: what rounding leaves


def too_large(scene: Scene) -> str:
    """Why a scene has no linear model with its parameters left in, if it is too large for one."""
    count = sum(len(joint.freedoms) for joint in scene.joints)
    if count <= _MOST_FREEDOMS:
        return ""
    return (
        f"its joints have {count} freedoms. {_MOST_FREEDOMS} take minutes and gigabytes, which grow with "
        "the third power. Fix joints that do not move (moving=[...] of load_robot), or connect models of "
        "parts of it."
    )


def problem_of_scene(scene: Scene, stage: Stage = lambda name: nullcontext()) -> Problem:
    """The linear relations of a scene around its equilibrium, parameters left in."""
    if reason := too_large(scene):
        raise SceneError(f"scene {scene.name!r}: {reason}")
    with stage("assemble"):
        both = assembly(scene)
        equations, exact = both.equations, both.exact
        inputs, outputs = choose_signals(scene, equations)
    with stage("trim"):
        _check_shares(scene, both)
        trim = _trim(equations, exact)
    with stage("linearize"):
        need = choose_states(scene, exact, inputs, outputs)

    def in_second_order() -> tuple[Form, ...]:
        again = both.second_order()
        if again is None:
            return ()
        return (Form(choose_states(scene, again, inputs, outputs).relations),)

    points = check_points(equations.parameters, SEED)
    return Problem(
        nouns=Nouns(
            "scene",
            scene.name,
            "the nonlinear equations",
            "the scene is so badly conditioned that double precision does not carry it (masses or "
            "lengths of very different size in one chain)",
            ", or keep masses and inertias away from zero",
        ),
        description=scene.description,
        text=scene_to_toml(scene),
        states=need.signals(equations.x_signals),
        inputs=tuple(equations.u_signals[k] for k in inputs),
        outputs=tuple(equations.y_signals[k] for k in outputs),
        parameters=equations.parameters,
        forms=(Form(need.relations),),
        points=points,
        reference=partial(reference_of, equations, exact, inputs, outputs, need, points),
        more_forms=in_second_order,
        singular=_singular_mass_matrix,
        trim=trim,
        is_regular=both.is_regular,
        constraints=both.constraints,
        fit_error_bound=equations.fit_error_bound,
    )


def choose_signals(scene: Scene, equations: Equations) -> tuple[list[int], list[int]]:
    """Positions of the inputs and outputs of a scene among the efforts and measures of its joints."""
    e = equations
    efforts = {e.u_signals[k].name: k for k in e.inputs}
    measures = {signal.name: k for k, signal in enumerate(e.y_signals)}
    inputs = _chosen(scene, "inputs", scene.inputs, efforts, e.default_inputs)
    outputs = _chosen(scene, "outputs", scene.outputs, measures, e.default_outputs)
    return _with_motions(e, inputs, outputs, is_default=scene.inputs is None), outputs


def choose_states(
    scene: Scene, equations: Equations, inputs: Sequence[int], outputs: Sequence[int]
) -> Need:
    """Linear relations of a scene with the states that it asks for."""
    relations = linearize(equations, inputs, outputs)
    count = len(equations.states)
    if scene.states == NEEDED:
        return without_free_modes(needed_states(relations, count))
    return all_states(relations, count, equations.ignorable)


def _chosen(
    scene: Scene,
    what: str,
    names: Sequence[str] | None,
    index: Mapping[str, int],
    default: tuple[int, ...],
) -> list[int]:
    """Positions of the chosen signals, or the default."""
    forces = {s.name for contact in scene.touches for group in contact.signals() for s in group}
    forces |= {coupling.signal(scene.joints).name for coupling in rigid(scene)}
    for name in names or ():
        if name in forces and name not in index and what == "outputs":
            raise SceneError(
                f"scene {scene.name!r}, outputs: {name!r} is not known, as contacts hold the same twice "
                "there: the equations know the sum of their forces only. Put a load of the kind support "
                "in place of one of them."
            )
        if name not in index:
            raise SceneError(
                f"scene {scene.name!r}, {what}: {unknown_name('signal', name, index)}"
                f"{_instead(scene, name) if what == 'outputs' else ''}"
            )
    return list(default) if names is None else [index[name] for name in names]


def _instead(scene: Scene, name: str) -> str:
    """What to do for an output that is named like a loop, a body or one of its ports."""
    item = name.partition(".")[0]
    if item in [loop.name for loop in scene.loops]:
        return (
            " Loads of loops are no outputs; a sensor of the kind joint_wrench measures those of a joint."
        )
    ports = [f"{body.name}.{port}" for body in scene.bodies for port in ("origin", *body.ports)]
    port = next((port for port in ports if item in port.split(".")), "")
    if not port:
        return ""
    port = port.removesuffix(".origin")
    return (
        f" What a body does is measured by a sensor: [sensors.NAME] with kind = 'position' and "
        f"port = {port!r} has the outputs NAME.x, NAME.y, NAME.z."
    )


def _with_motions(
    equations: Equations, inputs: Sequence[int], outputs: Sequence[int], *, is_default: bool
) -> list[int]:
    """The inputs with those of the motions that are felt, where the user names none.

    A road moves a wheel through the tire: its springs feel the displacement of the patch under it, its
    dampers the rate, and what stands on the patch by a joint feels the acceleration. The three are one
    motion. So a model has all of them that are felt: what lacks one answers another motion. One whose
    column of [B ; D] is zero is not felt, such as the rate of a steering angle where tires relax.
    """
    e, chosen = equations, list(inputs)
    if not e.moved:
        return chosen
    every = sorted({*chosen, *(k for moved in e.moved for k in moved.inputs)})
    matter = set(np.array(every)[felt_inputs(linearize(e, every, outputs))].tolist())
    for moved in e.moved:
        felt = [k for k in moved.inputs if k in matter]
        if is_default:
            chosen += felt
            continue
        missing = [e.u_signals[k].name for k in felt if k not in chosen]
        asked = [e.u_signals[k].name for k in moved.inputs if k in chosen]
        if asked and missing:
            raise SceneError(
                f"scene {e.name!r}, inputs: {', '.join(asked)} moves something that also feels "
                f"{', '.join(missing)}: springs and outputs feel the position, dampers the rate, and "
                "masses that stand on the joint the acceleration. Add "
                f"{', '.join(missing)} to the inputs, the derivatives of the same motion; or use "
                "imposed = true, whose only input is the acceleration."
            )
    return chosen


def _trim(equations: Equations, exact: Equations) -> TrimRelations:
    relations, e = trim_relations(exact), equations
    efforts, _ = trim_efforts(e, np.array([[parameter.nominal for parameter in e.parameters]]))
    signals = tuple(e.u_signals[k] for k in e.unknown)
    return TrimRelations(relations, signals, tuple(float(efforts[0, k]) for k in e.unknown))


def _singular_mass_matrix(number: float, names: Sequence[str]) -> str:
    return (
        "the mass matrix is singular, or nearly so, at nominal (condition "
        f"number {number:.0e}, whatever the units): nothing with enough "
        f"inertia moves with {', '.join(names)}. Give what these joints carry a mass or an inertia, "
        "or the joints an actuator_inertia."
    )


# notes -----------------------------------------------------------------------------------------


@arguments_checked
def notes(scene: Scene, trimmed: Mapping[Signal, float] | None = None) -> tuple[str, ...]:
    """Say what is easily overlooked in a scene that can be used.

    That are efforts that hold the equilibrium and are no input, springs in compression, forces
    of contacts that share what they hold, names, ports and sensors that are not used, a scene without
    gravity, and errors of the shapes of beams. What is probably wrong, such as a negative damping, is a
    `MbdlftWarning` of `to_lft` instead.

    Parameters
    ----------
    scene : Scene
    trimmed : mapping, optional
        The unknowns of the trim with their nominal values (SI), where they are known already.
    """
    if trimmed is None:
        point = solve_trim(assemble(scene))
        trimmed = dict(zip(point.signals, point.values, strict=True))
    kinds = {p.name: "parameter" for p in scene.parameters}
    sentences = [f"{error_sentence(body)}." for body in scene.bodies if isinstance(body, Beam)]
    sentences += [
        f"{kinds.get(name, 'constant')} {name!r} is declared and not used."
        for name in unused_names(scene)
    ]
    sentences += [f"port {port!r} is declared and not used." for port in unused_ports(scene)]
    sentences += _unseen(scene)
    if not ({"gravity", "acceleration"} & scene.model_fields_set or any(weightless(scene))):
        sentences.append("there is no gravity and no acceleration; both are zero by default.")
    return (*sentences, *_shared(scene), *_pushed(scene, trimmed), *_holding(scene, trimmed))


def _shared(scene: Scene) -> list[str]:
    """Forces of contacts that the equations know as a sum only."""
    if not scene.contacts:
        return []
    held, others = multipliers_of(scene)
    named = {s.name for contact in scene.contacts for group in contact.signals() for s in group}
    named |= {coupling.signal(scene.joints).name for coupling in rigid(scene)}
    both = assembly(scene)
    _check_shares(scene, both)
    every = [signal.name for signal in held + others]
    names = [every[k] for k in both.closure.shared if every[k] in named]
    if not names:
        return []
    return [
        f"known as sums only: the forces {', '.join(names)}, as contacts hold the same twice there. The "
        "trim gives all of a sum to some of them. Tires and supports, which give way, say what carries "
        "how much."
    ]


def _check_shares(scene: Scene, both: Assembly) -> None:
    """No output is a force of a contact along its plane where such a one holds the equilibrium as a sum.

    As the body turns, a part of that enters it. Whether it is zero is decided modulo a prime.
    """
    held, others = (tuple(signal.name for signal in part) for part in multipliers_of(scene))
    every = held + others
    shared = [every[k] for k in both.closure.shared]
    owners = {name.partition(".")[0] for name in shared}
    asked = [x for x in scene.outputs or () if x in others and x.partition(".")[0] in owners]
    if not asked:
        return
    trim, names = trim_relations(both.exact), [both.exact.u_signals[k].name for k in both.exact.unknown]
    slopes = (ca.jacobian(trim.residual, x) for x in (trim.unknown, trim.known))
    rows = modulo_prime(ca.horzcat(*slopes), _SEED)
    residues: NDArray[np.int64] = rows.residues.astype(np.int64)
    values = solved(residues[:, :-1], residues[:, -1:], rows.prime)[:, 0]
    loaded = [
        name
        for name, value in zip(names, values, strict=True)
        if value and name in shared and name in others
    ]
    if loaded:
        raise SceneError(
            f"scene {scene.name!r}, outputs: {asked[0]!r} is not known: as the body turns, it has a part "
            f"of {', '.join(loaded)}, which the equilibrium has as a sum with "
            f"{', '.join(name for name in shared if name not in names)} only. Put a load of the kind "
            "support or tire in place of one of the contacts."
        )


def _unseen(scene: Scene) -> list[str]:
    """Sensors of which no signal is an output, where outputs are listed."""
    if scene.outputs is None:
        return []
    seen = {name.partition(".")[0] for name in scene.outputs}
    return [
        f"sensor {sensor.name!r} is declared, and none of its signals is an output."
        for sensor in scene.sensors
        if sensor.name not in seen
    ]


def _pushed(scene: Scene, trimmed: Mapping[Signal, float]) -> list[str]:
    """Springs between two ports that are in compression."""
    densities = {signal.name: value for signal, value in trimmed.items()}
    names = [load.name for load in scene.loads if isinstance(load, Spring)]
    pushed = [name for name in names if densities.get(f"{name}.{Spring.signal.name}", 0.0) < -_NOTHING]
    if not pushed:
        return []
    return [
        f"in compression at nominal: spring {', '.join(map(repr, pushed))}. A spring acts along the "
        "line between its ports, so it gives way sideways when it is pushed. One that something guides, "
        "such as a tire, is a load of the kind strut, or a joint with a stiffness."
    ]


def _holding(scene: Scene, trimmed: Mapping[Signal, float]) -> list[str]:
    """Efforts of joints that hold the equilibrium and are no inputs: nothing in the model makes them.

    Where a joint has a spring, its effort at equilibrium is the static load of the spring.
    """
    if scene.inputs is None:
        return []
    efforts = set()
    for joint in scene.joints:
        declared = getattr(joint, "stiffness", 0.0)
        each = declared if isinstance(declared, tuple) else (declared,) * len(joint.freedoms)
        for freedom, stiffness in zip(joint.freedoms, each, strict=True):
            if stiffness == 0.0:
                efforts.add(f"{joint.name}.{freedom.effort.name}")
    largest: dict[str, float] = {}
    for signal, value in trimmed.items():
        largest[signal.unit] = max(1.0, abs(value), largest.get(signal.unit, 0.0))
    return [
        f"{signal.name} holds the equilibrium with {value:.4g} {signal.unit} at nominal, and is no "
        "input: a motor or a brake that the model does not show. If nothing holds the joint, give it "
        "preload = 0, and a position that is in equilibrium (mbdlft trim --positions)."
        for signal, value in trimmed.items()
        if signal.name in efforts
        and signal.name not in scene.inputs
        and abs(value) > _NOTHING * largest[signal.unit]
    ]
