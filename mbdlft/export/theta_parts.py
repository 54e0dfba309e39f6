"""What exports of the Delta-Theta form have in common: places of signals, ranges, and comments."""

from typing import NamedTuple

from mbdlft.base.errors import StructureError
from mbdlft.export.names import one_line
from mbdlft.system.theta import ONE, DeltaThetaModel, allowed_range


class Places(NamedTuple):
    """Numbers, from 0 on, of inputs and outputs of the linear part.

    Attributes
    ----------
    u, one, zeta : lists of int
        Inputs; `one` is empty without the constant 1.
    y, omega : lists of int
        Outputs.
    low, high : lists of float
        Of omega, where all functions may be evaluated, with what rounding may add.
    """

    u: list[int]
    one: list[int]
    zeta: list[int]
    y: list[int]
    omega: list[int]
    low: list[float]
    high: list[float]


def places_of(model: DeltaThetaModel, what: str) -> Places:
    """Where signals are.

    Raises
    ------
    StructureError
        The model has no functions.
    """
    if not model.functions:
        raise StructureError(
            f"model {model.name!r}: {what}: it has no nonlinear functions. Export model.linear."
        )
    inputs = [s.name for s in model.linear.inputs]
    outputs = [s.name for s in model.linear.outputs]
    omega = list(model.omega)
    low, high = [-float("inf")] * len(omega), [float("inf")] * len(omega)
    for f in model.functions:
        for name, ends in zip(f.signals, f.ranges, strict=True):
            k, (least, most) = omega.index(name), allowed_range(*ends)
            low[k], high[k] = max(low[k], least), min(high[k], most)
    return Places(
        [inputs.index(s.name) for s in model.inputs],
        [inputs.index(ONE)] if model.has_one else [],
        [inputs.index(name) for name in model.zeta],
        [outputs.index(s.name) for s in model.outputs],
        [outputs.index(name) for name in omega],
        low,
        high,
    )


def listed(model: DeltaThetaModel, begin: str) -> str:
    """Lines of a comment: states, u, y, and each function with the signals that it is of."""
    lines = []
    for what, given in (("x", model.linear.states), ("u", model.inputs), ("y", model.outputs)):
        lines.append(f"{what}: {', '.join(f'{s.name} ({s.unit})' for s in given) or 'none'}")
    lines.append(f"omega: {', '.join(model.omega)}")
    for f in model.functions:
        pairs = zip(f.arguments, f.signals, strict=True)
        lines.append(f"{f}, {', '.join(f'{a} = {s}' for a, s in pairs)}")
    return "\n".join(f"{begin}{one_line(line)}" for line in lines)
