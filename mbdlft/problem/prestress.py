"""Loads at equilibrium that go through elastic bodies, whose own stiffness they would change."""

from functools import lru_cache

import casadi as ca
import numpy as np

from mbdlft.base.array import Array
from mbdlft.base.errors import TrimError
from mbdlft.problem.equations import Equations, load_value, physical_symbols
from mbdlft.problem.sx.evaluate import evaluate_many

CARRIED = 1e-9  # of the loads of the scene: a smaller wrench through a body is rounding


def check_prestress(equations: Equations, points: Array, efforts: Array) -> None:
    """No load at equilibrium goes through an elastic body, unless its scene says that this is known.

    Raises
    ------
    TrimError
        It does.
    """
    e = equations
    if e.carried_by:
        carried, loads = evaluate_many(carried_function(e), points, efforts)
        largest = np.max(np.abs(loads), initial=0.0), np.max(np.abs(efforts), initial=0.0)
        check_carried(e, np.max(np.abs(carried[:, :, 0]), axis=0), max(map(float, largest)))


def check_carried(equations: Equations, largest: Array, load: float) -> None:
    """The same, from the largest wrenches (n_c,) and the largest load or effort.

    Raises
    ------
    TrimError
        A wrench is more than rounding of the loads.
    """
    e = equations
    loaded = np.flatnonzero(largest > CARRIED * load)
    if len(loaded):
        body = e.carried_by[int(loaded[0])]
        raise TrimError(
            f"scene {e.name!r}: body {body!r} is elastic and carries a load at equilibrium (up to "
            f"{np.max(largest[loaded]):.3g} N or N m). The model takes the given shape for that under "
            "this load, and has the effects of the load through the displaced ports and of the weight of "
            "the displaced mass; it does not have the change of the body's own stiffness by the load "
            "(buckling, tension), which is known for axial forces in beams only. Where the change may "
            "be left out, write prestress = 'neglected' in the body; where only that of the other "
            "loads of a beam may be, prestress = 'axial'."
        )


@lru_cache(maxsize=1)  # a sweep asks for it again and again
def carried_function(e: Equations) -> ca.Function:
    """(physical values, efforts) -> wrenches through elastic bodies, loads of the scene."""
    symbols, p, cosine, sine = physical_symbols(e.parameters)
    still = [e.xdot, e.x, e.z]
    rest = ca.substitute([e.carried], still, [ca.SX.zeros(s.numel()) for s in still])
    function = ca.Function("carried", [e.u, e.load, e.p, e.cosine, e.sine], rest)
    u, load = ca.SX.sym("u", e.u.numel()), load_value(e, p)
    values = function(u, load, p, cosine, sine)
    return ca.Function("carried", [symbols, u], [ca.densify(values), ca.densify(load)])
