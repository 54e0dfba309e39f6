"""What a user may have overlooked: notes on a scene, and warnings beside the output of a command.

Notes are facts, printed with a result and in its JSON; warnings are lines on the error stream, and in the
JSON, too.
"""

import sys
from collections.abc import Sequence
from typing import TYPE_CHECKING

from mbdlft.base.signal import Signal

if TYPE_CHECKING:
    from mbdlft.multibody.joint import Joint
    from mbdlft.multibody.scene import Scene

_NOTHING = 1e-9  # of the largest effort in its unit, or of 1 N or 1 N m: what rounding leaves
WARNINGS: list[str] = []  # that this command has shown


def warn(message: object) -> None:
    """Show a warning: one line beside the output."""
    WARNINGS.append(str(message))
    sys.stderr.write(f"mbdlft: warning: {message}\n")


def scene_notes(
    scene: "Scene", trimmed: Sequence[Signal] = (), values: Sequence[float] = ()
) -> list[str]:
    """Notes on facts that a user may have overlooked.

    `trimmed` are the unknowns of the trim with their nominal `values`.
    """
    from mbdlft.multibody.body import Beam
    from mbdlft.multibody.body.beam_errors import error_sentence
    from mbdlft.multibody.scene.quantities import unused_names, unused_ports

    notes = [f"{error_sentence(body)}." for body in scene.bodies if isinstance(body, Beam)]
    notes += [f"note: {name!r} is declared and not used." for name in unused_names(scene)]
    notes += [f"note: port {port!r} is declared and not used." for port in unused_ports(scene)]
    if not any(scene.gravity) and not any(scene.acceleration):
        notes.append("note: there is no gravity and no acceleration; both are zero by default.")
    return notes + _holding(scene, trimmed, values)


def _holding(scene: "Scene", trimmed: Sequence[Signal], values: Sequence[float]) -> list[str]:
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
    largest = {
        signal.unit: max(
            [1.0, *(abs(v) for s, v in zip(trimmed, values, strict=True) if s.unit == signal.unit)]
        )
        for signal in trimmed
    }
    return [
        f"note: {signal.name} holds the equilibrium with {value:.4g} {signal.unit} at nominal, and is no "
        "input: a motor or a brake that the model does not show. If nothing holds the joint, give it "
        "preload = 0, and a position that is in equilibrium (mbdlft trim --positions)."
        for signal, value in zip(trimmed, values, strict=True)
        if signal.name in efforts
        and signal.name not in scene.inputs
        and abs(value) > _NOTHING * largest[signal.unit]
    ]


def _stiffness(joint: "Joint") -> Sequence[object]:
    """The stiffness of each coordinate of a joint, as it is declared; 0.0 where there is no spring."""
    declared = getattr(joint, "stiffness", 0.0)
    return declared if isinstance(declared, tuple) else (declared,) * len(joint.freedoms)
