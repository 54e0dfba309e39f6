"""Facts on a scene that its user may have overlooked; the command line prints them with its results."""

from collections.abc import Mapping, Sequence

from mbdlft.base.unit import Signal
from mbdlft.multibody.assembly import assemble
from mbdlft.multibody.body import Beam
from mbdlft.multibody.body.beam import error_sentence
from mbdlft.multibody.force import Spring
from mbdlft.multibody.joint import Joint
from mbdlft.multibody.scene import Scene
from mbdlft.multibody.scene.quantities import unused_names, unused_ports
from mbdlft.problem.trim import solve_trim

_NOTHING = 1e-9  # of the largest effort in its unit, or of 1 N or 1 N m: what rounding leaves


def notes(scene: Scene, trimmed: Mapping[Signal, float] | None = None) -> tuple[str, ...]:
    """Say what is easily overlooked in a scene that can be used.

    That are efforts that hold the equilibrium and are no input, springs that are pushed together, names,
    ports and sensors that are not used, a scene without gravity, and errors of the shapes of beams.
    What is probably wrong, such as a negative damping, is a `MbdlftWarning` of `to_lft` instead.

    Parameters
    ----------
    scene : Scene
    trimmed : mapping, optional
        The unknowns of the trim with their nominal values (SI), where they are known already.

    Raises
    ------
    SceneError, NotRationalError, WellPosednessError, TrimError
        The scene cannot be used.
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
    if not any(scene.gravity) and not any(scene.acceleration):
        sentences.append("there is no gravity and no acceleration; both are zero by default.")
    return (*sentences, *_pushed(scene, trimmed), *_holding(scene, trimmed))


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
    """Springs between two ports that carry a load by being pushed together."""
    densities = {signal.name: value for signal, value in trimmed.items()}
    names = [load.name for load in scene.loads if isinstance(load, Spring)]
    pushed = [name for name in names if densities.get(f"{name}.{Spring.signal.name}", 0.0) < -_NOTHING]
    if not pushed:
        return []
    return [
        f"pushed together at nominal: spring {', '.join(map(repr, pushed))}. A spring acts along the "
        "line between its ports, so it gives way sideways when it is pushed. One that something guides, "
        "such as a tire, is a load of the kind strut, or a joint with a stiffness."
    ]


def _holding(scene: Scene, trimmed: Mapping[Signal, float]) -> list[str]:
    """Efforts of joints that hold the equilibrium and are no inputs: nothing in the model makes them.

    Where a joint has a spring, its effort at equilibrium is the static load of the spring.
    """
    if scene.inputs is None:
        return []
    efforts = {
        f"{joint.name}.{freedom.effort.name}"
        for joint in scene.joints
        for freedom, stiffness in zip(joint.freedoms, _stiffness(joint), strict=True)
        if stiffness == 0.0
    }
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


def _stiffness(joint: Joint) -> Sequence[object]:
    """The stiffness of each coordinate of a joint, as it is declared; 0.0 where there is no spring."""
    declared = getattr(joint, "stiffness", 0.0)
    return declared if isinstance(declared, tuple) else (declared,) * len(joint.freedoms)
