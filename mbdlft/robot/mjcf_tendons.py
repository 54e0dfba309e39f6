"""Fixed tendons of MJCF files: linear relations of hinges and slides, which become couplings.

A fixed tendon has the length L = c1 q1 + c2 q2 + ... of the coordinates of its joints. With a spring and
a damper its force is -k (L - L_s) - d L_dot, where L_s is the end of the range of slack lengths beyond
which L is; inside of the range the spring is slack. An equality holds L - L_0 = a + b (L' - L'_0) with
another tendon, or L - L_0 = a, rigidly; lengths with a 0 are those of the reference of the file.
"""

from collections.abc import Mapping

import numpy as np

from mbdlft.base.array import Array
from mbdlft.base.errors import SceneError
from mbdlft.robot.description import RobotCoupling, first_of, unused
from mbdlft.robot.mjcf_model import Compiled

_FORCES = ("stiffness", "damping", "armature", "frictionloss")


def couplings_of(
    model: Compiled, positions: Array, driven: Mapping[str, object]
) -> tuple[tuple[RobotCoupling, ...], tuple[str, ...]]:
    """Couplings of fixed tendons at `positions` (nq,), and sentences on what is left out of tendons.

    `driven` are the joints with actuators. Of the joints of a rigid coupling the first without one is
    held by the tendon.
    """
    made: list[RobotCoupling] = []
    for k in model.active("TENDON"):
        made.append(_rigid(model, k, {*driven, *(coupling.held for coupling in made)}))
    left_out = []
    for tendon in range(model.arrays.ntendon):
        sprung = _sprung(model, tendon, positions)
        made += [sprung] if sprung else []
        lost = [key for key in _FORCES if getattr(model.arrays, f"tendon_{key}")[tendon]]
        lost = [key for key in lost if not sprung or key not in ("stiffness", "damping")]
        if lost or not (sprung or _is_in_equality(model, tendon)):
            name = model.name_of("TENDON", tendon)
            left_out.append(f"{name} with its {', '.join(lost)}" if lost else name)
    names: list[str] = []
    for coupling in made:
        names.append(unused(coupling.name, (*model.joint_names, *names)))
    named = tuple(c._replace(name=name) for c, name in zip(made, names, strict=True))
    return named, (f"tendons {first_of(left_out)}",) if left_out else ()


def _factors(model: Compiled, tendon: int) -> dict[str, float] | None:
    """The coefficients of a fixed tendon by the names of its joints; None of one along a path."""
    first, count = model.arrays.tendon_adr[tendon], model.arrays.tendon_num[tendon]
    factors: dict[str, float] = {}
    for place in range(first, first + count):
        if model.word("mjtWrap", model.arrays.wrap_type[place]) != "JOINT":
            return None
        name = model.joint(int(model.arrays.wrap_objid[place]))
        factors[name] = factors.get(name, 0.0) + float(model.arrays.wrap_prm[place])
    return factors


def _rigid(model: Compiled, equality: int, taken: set[str]) -> RobotCoupling:
    """The relation of an equality of one tendon or two."""
    first, second = int(model.arrays.eq_obj1id[equality]), int(model.arrays.eq_obj2id[equality])
    constant, slope, *higher = (float(entry) for entry in model.arrays.eq_data[equality][:5])
    where = (
        f"equality {model.name_of('EQUALITY', equality)!r} of tendon {model.name_of('TENDON', first)!r}"
    )
    factors, others = _factors(model, first), _factors(model, second) if second >= 0 else {}
    if factors is None or others is None:
        raise SceneError(
            f"{where}: expected fixed tendons, got one along a path in space, whose length is not "
            "linear. A scene has no others; take it out of the file."
        )
    if any(higher):
        raise SceneError(
            f"{where}: expected a linear relation, polycoef = 'a b'. A scene has no others; take it out "
            "of the file."
        )
    for name, factor in others.items():
        factors[name] = factors.get(name, 0.0) - slope * factor
    factors = {name: factor for name, factor in factors.items() if factor}
    if len(factors) < 2:
        raise SceneError(
            f"{where}: expected two or more joints, got {', '.join(factors) or 'none'}. A joint that "
            "does not move is a fixed one; make it so in the file."
        )
    held = next((name for name in factors if name not in taken), next(iter(factors)))
    return RobotCoupling(model.name_of("EQUALITY", equality), factors, held=held, offset=constant)


def _sprung(model: Compiled, tendon: int, positions: Array) -> RobotCoupling | None:
    """The spring and the damper of a fixed tendon over two or more joints; None without them."""
    k, d = (
        0.0 if model.disabled(flag) else float(getattr(model.arrays, f"tendon_{key}")[tendon])
        for key, flag in (("stiffness", "SPRING"), ("damping", "DAMPER"))
    )
    factors = {name: c for name, c in (_factors(model, tendon) or {}).items() if c}
    if not (k or d) or len(factors) < 2:
        return None
    at = {model.joint(j): int(model.arrays.jnt_qposadr[j]) for j in range(model.arrays.njnt)}
    length = sum(c * float(positions[at[name]]) for name, c in factors.items())
    low, high = (float(end) for end in model.arrays.tendon_lengthspring[tendon])
    if low < high and k:
        if length in (low, high):
            raise SceneError(
                f"tendon {model.name_of('TENDON', tendon)!r}: its length {length:g} is the end of its "
                f"range of slack lengths [{low:g}, {high:g}], where its stiffness jumps from 0 to {k:g}: "
                "there is no linear model. Change springlength, or the positions, in the file."
            )
        k = k if length > high or length < low else 0.0
    # positions of the scene are counted from the reference of the file, where the tendon has length0
    slack = (low if length < low else high) - float(model.arrays.tendon_length0[tendon])
    return RobotCoupling(model.name_of("TENDON", tendon), factors, stiffness=k, damping=d, offset=slack)


def _is_in_equality(model: Compiled, tendon: int) -> bool:
    both = np.array([model.arrays.eq_obj1id, model.arrays.eq_obj2id])
    return any(tendon in both[:, k] for k in model.active("TENDON"))
