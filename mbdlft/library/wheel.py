"""The imbalance of a wheel that spins at a steady speed, as a disturbance."""

from collections.abc import Mapping, Sequence
from typing import Any

from mbdlft.base.description import Expected
from mbdlft.base.parameter import Parameter
from mbdlft.library.block import linear_block
from mbdlft.system.model import LFTModel


def imbalance(
    static: float | str,
    dynamic: float | str,
    speed: float | str,
    parameters: Sequence[Parameter] = (),
    *,
    name: str = "imbalance",
) -> LFTModel:
    """Force m r w^2 and torque m r h w^2 of an imbalance on the body that carries the wheel.

    A mass m at the radius r and the height h above the port, at the angle w t from x about the spin axis
    z, pulls with m r w^2 [cos, sin, 0] and turns with m r h w^2 [-sin, cos, 0].

    Parameters
    ----------
    static : number or expression, m r (kg m)
    dynamic : number or expression, m r h (kg m^2)
    speed : number or expression, w (rad/s)
    parameters : sequence of Parameter
    name : str

    Returns
    -------
    LFTModel
        Static; inputs ``NAME.cosine`` and ``NAME.sine`` [1], which are cos w t and sin w t; outputs
        ``force.x``, ``force.y`` (N), ``torque.x``, ``torque.y`` (N m). To be put in series with
        the inputs of two forces and two torques of magnitude 0 at the port of the wheel.

    Raises
    ------
    SceneError
        The speed is not positive, an imbalance is negative, or a unit does not fit.
    """
    return linear_block(
        name,
        {
            "static": Expected(static, "kg m"),
            "dynamic": Expected(dynamic, "kg m^2"),
            "speed": Expected(speed, "rad/s"),
        },
        parameters,
        _matrix,
        may_vanish=("static", "dynamic"),
        inputs=[f"{name}.cosine", f"{name}.sine"],
        outputs=["force.x", "force.y", "torque.x", "torque.y"],
    )


def _matrix(v: Mapping[str, Any]) -> list[list[Any]]:
    force, torque = (v[key] * (v["speed"] * v["speed"]) for key in ("static", "dynamic"))
    return [[force, 0.0], [0.0, force], [0.0, -torque], [torque, 0.0]]
