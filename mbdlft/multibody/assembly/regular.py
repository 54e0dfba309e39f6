"""Proof that the mass matrix of a tree is regular at every value of the parameters.

Let the joints of a tree of rigid bodies have the rates v, not all zero. Of the joints with rates that
are not zero take one that is nearest to the ground. Its parent is at rest, so its child, and what is
fixed to it, move as the joint alone moves them, with the energy v_j' H_j v_j / 2; the energy of no body
is negative. If H_j > 0 for every joint, the energy v'M v / 2 is positive, and M is regular. H_j depends
on what is declared at one joint and a few bodies only, so intervals show that its pivots are positive,
with the range cut where they have to.
"""

from collections.abc import Mapping
from dataclasses import replace
from functools import partial

import casadi as ca
import numpy as np

from mbdlft.base.description import Values
from mbdlft.base.parameter import Parameter
from mbdlft.exact.interval import FUNCTIONS, Interval, decimal, find_zero
from mbdlft.multibody.assembly.kinematics import Placed, inertial_wrenches, motions, pass_inward
from mbdlft.multibody.assembly.tree import Link
from mbdlft.multibody.body import ElasticBody
from mbdlft.multibody.body.rigid import PRODUCTS
from mbdlft.multibody.scene.checks import LABELS
from mbdlft.multibody.scene.quantities import owner_name
from mbdlft.problem.sx.constants import in_doubles, is_constant
from mbdlft.problem.sx.tapes import arithmetic, fold

_RULES = arithmetic(decimal, FUNCTIONS)
_PRODUCTS = tuple(f"inertia.{name}" for name in PRODUCTS)
_MATRIX = tuple(f"inertia.{k}" for k in ("xx", "xy", "xz", "xy", "yy", "yz", "xz", "yz", "zz"))


def is_regular(
    at_rest: Placed,
    accelerations: Mapping[str, ca.SX],
    parameters: tuple[Parameter, ...],
    symbols: tuple[ca.SX, ca.SX, ca.SX],
) -> bool:
    """Whether every joint of a tree is proved to move inertia, whatever the parameters are.

    False says that it was not proved. `at_rest` is the tree with q = v = 0 and symbols for the
    accelerations (n,) by owner; `symbols` are p, cosine and sine (n_p,), as in `Equations`.
    """
    if any(isinstance(body, ElasticBody) for body in at_rest.bodies.values()):
        return False
    range_ = _Range(parameters, symbols)
    if not all(
        _has_energy(at_rest.values.get(owner_name(link.child), {}), range_)
        and _has_energy(at_rest.values.get(link.owner, {}), range_)
        for link in at_rest.links
    ):
        return False
    return all(
        range_.keeps_positive(
            _pivots(ca.jacobian(in_doubles(_efforts_alone(at_rest, link)), accelerations[link.owner]))
        )
        for link in at_rest.links
        if link.joint.freedoms and not getattr(link.joint, "imposed", False)
    )


class _Range:
    """The range of the parameters, over which signs are proved."""

    def __init__(self, parameters: tuple[Parameter, ...], symbols: tuple[ca.SX, ca.SX, ca.SX]) -> None:
        self.parameters, self.symbols = parameters, symbols
        self.factors = np.array([p.factor for p in parameters])
        self.nominal = np.array([p.nominal for p in parameters])
        angles = self.factors * self.nominal
        self.point = (self.nominal, np.cos(angles), np.sin(angles))

    def keeps_positive(self, expressions: ca.SX) -> bool:
        """Whether all entries of a column are proved to be positive; False if it was not proved."""
        column = in_doubles(expressions)
        function = ca.Function("entries", list(self.symbols), [ca.densify(column)])
        if not np.all(function(*self.point).full() > 0.0):
            return False
        used = {s.name() for s in ca.symvar(column)}
        bounds = {
            p.name: (p.low, p.high)
            for k, p in enumerate(self.parameters)
            if any(symbol[k].name() in used for symbol in self.symbols)
        }
        return all(
            find_zero(partial(self._entry, function, k), bounds) is None for k in range(column.numel())
        )

    def _entry(self, function: ca.Function, k: int, box: Mapping[str, Interval]) -> Interval:
        intervals = [box.get(p.name, Interval(p.low, p.high)) for p in self.parameters]
        turns = [item * factor for item, factor in zip(intervals, self.factors, strict=True)]
        arguments = [intervals, *([FUNCTIONS[name](x) for x in turns] for name in ("cos", "sin"))]
        (entries,) = fold(function, _RULES, *arguments)
        return Interval.of(entries[k])


def _has_energy(values: Values, range_: _Range) -> bool:
    """Whether the energy of a body, or of an actuator, is proved not to be negative.

    Numbers have been checked; what depends on parameters has to be positive.
    """
    open_ = [
        label
        for label, value in values.items()
        if label.startswith((*LABELS, "inertia.")) and not is_constant(ca.SX(value))
    ]
    entries = [values[label] for label in open_ if not label.startswith("inertia.")]
    of_inertia = [label for label in open_ if label.startswith("inertia.")]
    if any(label in values and not ca.SX(values[label]).is_zero() for label in _PRODUCTS) and of_inertia:
        if any(label not in values for label in _MATRIX):
            return False
        J = ca.reshape(ca.vertcat(*(ca.SX(values[label]) for label in _MATRIX)), 3, 3)
        entries.append(_pivots(J))
    else:
        entries += [values[label] for label in of_inertia]
    return not entries or range_.keeps_positive(ca.vertcat(*entries))


def _efforts_alone(at_rest: Placed, link: Link) -> ca.SX:
    """Efforts (n,) of a joint that moves its child, and what is fixed to it, alone."""
    group, links = {link.child.name}, [link]
    for other in at_rest.links:
        if other.parent.name in group and not other.joint.freedoms and other is not link:
            group.add(other.child.name)
            links.append(other)
    alone = replace(at_rest, links=tuple(links))
    moving = motions(alone, ca.SX(3, 3), {link.parent.name: ca.SX(3, 3)})
    needed = inertial_wrenches(alone, moving)
    return pass_inward(alone, moving, {**needed, link.parent.name: ca.SX(3, 2)}).efforts[link.owner]


def _pivots(H: ca.SX) -> ca.SX:
    """Pivots (n,) of a symmetric matrix (n, n): it is positive definite if they are positive."""
    return ca.SX(ca.ldl(ca.densify(H), False)[0])  # noqa: FBT003  # in this order
