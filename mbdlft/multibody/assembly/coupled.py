"""Couplings of the coordinates of a tree: coefficients, efforts and forces; what is checked of them.

Whether relations are independent is decided modulo a prime, for generic values of the parameters; that
they are at every value is proved with the constraints of loops (`constraint_relations`).
"""

from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any, NamedTuple

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from mbdlft.base.description import Expected, Values
from mbdlft.base.errors import MbdlftError, SceneError
from mbdlft.base.unit import Freedom, Signal
from mbdlft.exact.modular import null_space, rank
from mbdlft.multibody.assembly.kinematics import View
from mbdlft.multibody.assembly.tree import Symbols, degrees
from mbdlft.multibody.coupling import Coupling
from mbdlft.multibody.joint import Joint, coordinate_label, with_entry
from mbdlft.multibody.scene.quantities import Place, owner_name
from mbdlft.multibody.scene.scene import Scene
from mbdlft.problem.sx.constants import modulo_prime

_SEED = 20261125  # of the residues that stand for parameters
_APART = 1e-9  # of the largest term of a relation: what the sum at the declared positions may miss


def rigid(scene: Scene) -> list[Coupling]:
    """The couplings that are constraints."""
    return [coupling for coupling in scene.couplings if coupling.stiffness is None]


def multipliers_of(scene: Scene) -> tuple[list[Signal], list[Signal]]:
    """The multipliers of holonomic constraints, of loops, rigid couplings and contacts, and of others."""
    of_loops = [signal for loop in scene.loops for signal in loop.signals()]
    of_loops += [coupling.signal(scene.joints) for coupling in rigid(scene)]
    of_contacts = [contact.signals() for contact in scene.touches]
    held = [signal for normal, _ in of_contacts for signal in normal]
    return of_loops + held, [signal for _, others in of_contacts for signal in others]


def relations(scene: Scene, couplings: Sequence[Coupling], view: View) -> ca.SX:
    """Coefficients (m, n) of couplings by the coordinates of the tree."""
    every = degrees(view.now.links)
    index = {degree.measure(0).name: k for k, degree in enumerate(every if couplings else ())}
    matrix = ca.SX(len(couplings), len(every))
    for row, coupling in enumerate(couplings):
        places = coupling.freedoms(scene.joints)
        values = view.now.values[owner_name(coupling)]
        for (joint, freedom), c in zip(places, coupling.coefficients(values), strict=True):
            matrix[row, index[freedom.measures[0].of(joint.name).name]] = c
    return matrix


def with_positions(scene: Scene) -> tuple[Scene, dict[str, str]]:
    """The scene with the positions that follow from couplings with an offset; the coupling by joint.

    Coordinates without a declared position follow. Where a coupling leaves several of them open, its
    first one follows and the others are at zero, if they follow no other coupling.
    """
    every = [(c, c.freedoms(scene.joints)) for c in scene.couplings if c.offset is not None]
    joints, follows = {joint.name: joint for joint in scene.joints}, dict[str, str]()
    free = {
        (joint.name, freedom)
        for _, places in every
        for joint, freedom in places
        if coordinate_label("position", freedom) in joint.quantities()
        and "position" not in joint.model_fields_set
        and getattr(joint, "rate", None) is None
    }
    while True:
        counted = [
            (c, places, [k for k, (joint, freedom) in enumerate(places) if (joint.name, freedom) in free])
            for c, places in every
        ]
        pending = [entry for entry in counted if entry[2]]
        if not pending:
            return scene.model_copy(update={"joints": tuple(joints.values())}), follows
        coupling, places, (first, *more) = min(pending, key=lambda entry: len(entry[2]) > 1)
        joint, freedom = places[more[-1] if more else first]
        free.remove((joint.name, freedom))
        if not more:
            position = _position(coupling, scene, joints, first)
            joints[joint.name] = with_entry(joints[joint.name], "position", freedom, position)
            follows[joint.name] = coupling.name


@contextmanager
def following(scene: Scene) -> Iterator[Scene]:
    """The scene with positions that follow; an error on one of them says from where it is."""
    placed, follows = with_positions(scene)
    try:
        yield placed
    except MbdlftError as error:
        for joint, coupling in follows.items():
            if f"joint {joint!r}, position" in str(error):
                raise type(error)(
                    f"{error} This position follows from the offset of coupling {coupling!r}: give the "
                    "joint one of its own, or leave the offset out."
                ) from None
        raise


def _position(coupling: Coupling, scene: Scene, joints: Mapping[str, Joint], follower: int) -> str:
    """(offset - the other terms)/coefficient as a text, of the coordinate of one term."""
    quantities, terms = coupling.quantities(scene.joints), coupling.terms()
    factors = [_text(quantities[term.label]) if term.label else "1" for term in terms]
    total, ratio = _text(quantities["offset"]), f"{terms[follower].sign:g}*{factors[follower]}"
    for k, (joint, freedom) in enumerate(coupling.freedoms(scene.joints)):
        place = joints[joint.name].quantities().get(coordinate_label("position", freedom))
        if k != follower and place is not None and place.source != 0.0:
            total += f" - ({terms[k].sign:g})*{factors[k]}*{_text(place)}"
    return total if ratio == "1*1" else f"({total})/({ratio})"


def _text(quantity: Expected) -> str:
    """A quantity in an expression, with its unit."""
    is_bare = isinstance(quantity.source, str) or quantity.unit == "1"
    return f"({quantity.source})" if is_bare else f"({quantity.source!r} [{quantity.unit}])"


class Coupled(NamedTuple):
    """What couplings do: efforts (n,) on the coordinates, and the deviations of their forces (m,)."""

    efforts: ca.SX
    forces: ca.SX
    signals: tuple[Signal, ...]


def coupled(
    scene: Scene,
    view: View,
    total: ca.SX,
    change: ca.SX,
    preloads: Sequence[ca.SX],
    shared: Collection[int],
) -> Coupled:
    """The couplings of a tree at its coordinates.

    `total` and `change` (m,) are multipliers of the rigid ones, with and without their values at
    equilibrium, `preloads` the forces of the others at equilibrium. Forces of rigid ones that are
    `shared` are left out: contacts hold the same, so they are known as a sum only.
    """
    q, v = (ca.vertcat(*(at[order] for at in view.coordinates.values())) for order in (0, 1))
    efforts, forces, k, taken = ca.SX(q.numel(), 1), [ca.SX(0, 1)], 0, iter(preloads)
    signals = list[Signal]()
    for coupling in scene.couplings:
        row, values = relations(scene, [coupling], view), view.now.values[owner_name(coupling)]
        if coupling.stiffness is None:
            whole, force, k = total[k], change[k], k + 1
        else:
            force = -values["stiffness"] * ca.mtimes(row, q) - values["damping"] * ca.mtimes(row, v)
            whole = next(taken) + force
        efforts += row.T * whole
        if coupling.stiffness is not None or k - 1 not in shared:
            forces.append(force)
            signals.append(coupling.signal(scene.joints))
    return Coupled(efforts, ca.vertcat(*forces), tuple(signals))


def check_couplings(scene: Scene, view: View, symbols: Symbols) -> None:
    """Rigid couplings are independent and let something move; positions and rates fit."""
    for coupling in scene.couplings:
        _check_positions(scene, coupling, view, symbols)
        _check_rates(scene, coupling, view)
    chosen = rigid(scene)
    if not chosen:
        return
    residues = modulo_prime(relations(scene, chosen, view), _SEED)
    matrix: NDArray[np.int64] = residues.residues.astype(np.int64)
    every, count = degrees(view.now.links), len(chosen)
    listed = ", ".join(coupling.name for coupling in chosen)
    idle = null_space(matrix.T, residues.prime)
    if idle.shape[1]:
        named = [coupling.name for coupling, row in zip(chosen, idle, strict=True) if np.any(row)]
        raise SceneError(
            f"scene {scene.name!r}: the rigid couplings {', '.join(named)} say {len(named)} things, of "
            f"which {len(named) - idle.shape[1]} are independent: the others follow, and "
            "their forces are not determined. Leave them out, or give them a stiffness."
        )
    locked = [
        degree.measure(0).name
        for k, degree in enumerate(every)
        if rank(np.delete(matrix, k, axis=1), residues.prime) < count
    ]
    if locked:
        raise SceneError(
            f"scene {scene.name!r}: the rigid couplings {listed} lock {', '.join(locked)}: with their "
            "ratios nothing there can move, as in a loop of gears that do not fit or a joint with two "
            "ratios. Correct the ratios, leave one out, or give one a stiffness."
        )
    imposed = [k for k, degree in enumerate(every) if degree.kind in ("imposed", "motion")]
    if rank(np.delete(matrix, imposed, axis=1), residues.prime) < count:
        raise SceneError(
            f"scene {scene.name!r}: the rigid couplings {listed} hold the imposed joints "
            f"{', '.join(every[k].name for k in imposed)} together, which move as their inputs say. "
            "Impose one of them only."
        )


def _check_positions(scene: Scene, coupling: Coupling, view: View, symbols: Symbols) -> None:
    """The declared positions have the sum that the offset says, at nominal and at other points."""
    quantities = coupling.quantities(scene.joints)
    if "offset" not in quantities:
        return
    where, values = owner_name(coupling), view.now.values[owner_name(coupling)]
    places = [
        position_of(scene, joint, freedom, symbols, view.now.values)
        for joint, freedom in coupling.freedoms(scene.joints)
    ]
    terms = [ca.SX(c) * x for c, x in zip(coupling.coefficients(values), places, strict=True)]
    offset = quantity_value(scene, Place(where, "offset"), quantities["offset"], symbols, values)
    for at in symbols.evaluate(ca.vertcat(*terms, offset)):
        total, wanted = float(np.sum(at[:-1])), float(at[-1, 0])
        if not abs(total - wanted) <= _APART * max(float(np.max(np.abs(at))), 1e-300):
            listed = ", ".join(
                f"{term.coordinate} = {place:.6g}"
                for term, place in zip(
                    coupling.terms(), symbols.evaluate(ca.vertcat(*places))[0][:, 0], strict=True
                )
            )
            raise SceneError(
                f"{where}: the declared positions ({listed} at nominal) make {total:.6g} "
                f"{coupling.measured_in(scene.joints)} at nominal or elsewhere in the range, and the "
                f"offset is {wanted:.6g}. Correct a position or the offset; without one the teeth mesh "
                "as the positions are."
            )


def position_of(scene: Scene, joint: Joint, freedom: Freedom, symbols: Symbols, values: Any) -> ca.SX:
    """Declared position (rad, m) of a coordinate, a function of p."""
    owner, label = owner_name(joint), coordinate_label("position", freedom)
    expected = joint.quantities().get(label)
    if expected is None:  # of a free joint and of balls the orientation and the place are one
        return ca.SX(0.0)
    return quantity_value(scene, Place(owner, label), expected, symbols, values[owner])


def quantity_value(
    scene: Scene, place: Place, expected: Expected, symbols: Symbols, values: Values
) -> ca.SX:
    """A quantity of an owner, an angle as itself (rad), a function of p."""
    if expected.unit == "rad":
        return ca.SX(symbols.angle(scene, place, expected))
    return ca.SX(values[place.label])


def _check_rates(scene: Scene, coupling: Coupling, view: View) -> None:
    """Steady rates of coupled joints fit each other, for all values of the parameters."""
    values, joints = view.now.values, [joint for joint, _ in coupling.freedoms(scene.joints)]
    coefficients = coupling.coefficients(values[owner_name(coupling)])
    rates = (values[owner_name(joint)].get("rate", 0.0) for joint in joints)
    total = sum((c * rate for c, rate in zip(coefficients, rates, strict=True)), start=ca.SX(0))
    if not modulo_prime(total, _SEED).residues.any():
        return
    given = ", ".join(
        f"{term.coordinate} at {getattr(joint, 'rate', None) or 0.0!r}"
        for term, joint in zip(coupling.terms(), joints, strict=True)
    )
    raise SceneError(
        f"{owner_name(coupling)}: the steady rates do not fit: {given} (rad/s). With the coefficients of "
        "the coupling their sum must vanish for all values of the parameters, such as rate = 'ratio*W' "
        "of one and rate = 'W' of the other."
    )
