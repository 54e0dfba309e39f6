"""The symbols of a scene: coordinates, parameters, and quantities in terms of them."""

from fractions import Fraction
from typing import Any

import casadi as ca
import numpy as np

from mbdlft.base.array import Array
from mbdlft.base.description import Expected, Values
from mbdlft.base.errors import SceneError
from mbdlft.base.expression import evaluate
from mbdlft.base.parameter import Parameter
from mbdlft.base.samples import random
from mbdlft.multibody.assembly.tree import Link, coordinate_owners, degrees
from mbdlft.multibody.joint import Turn
from mbdlft.multibody.scene.quantities import Place, angle_at, owners, value_at
from mbdlft.multibody.scene.scene import Scene
from mbdlft.multibody.spatial import Coordinate
from mbdlft.problem.equations import rows_of
from mbdlft.problem.sx.constants import FUNCTIONS, cosine_sine, in_doubles, literal, pi_times

_POINTS = 16  # random points at which loops are checked, beside nominal


class Symbols:
    """The symbols of one assembly."""

    def __init__(
        self, scene: Scene, parameters: tuple[Parameter, ...], links: tuple[Link, ...]
    ) -> None:
        n = len(degrees(links))
        if n == 0:
            raise SceneError(f"scene {scene.name!r}: all joints are fixed, so nothing moves.")
        self.x = ca.SX.sym("x", 2 * n)
        self.xdot = ca.SX.sym("xdot", 2 * n)
        self.q, self.v, self.a = self.x[:n], self.x[n:], self.xdot[n:]
        self.p = ca.SX.sym("p", len(parameters))
        self.cosine = ca.SX.sym("cosine", len(parameters))
        self.sine = ca.SX.sym("sine", len(parameters))
        self.parameters = parameters
        self.index = {parameter.name: k for k, parameter in enumerate(parameters)}
        self.names: dict[str, Any] = {
            name: literal(value) for name, value in scene.constant_values().items()
        }
        self.names |= {"pi": pi_times(1), "deg": pi_times(Fraction(1, 180))}
        for name, k in self.index.items():
            factor = parameters[k].factor
            self.names[name] = self.p[k] if factor == 1.0 else literal(factor) * self.p[k]

    def coordinates(self, links: tuple[Link, ...]) -> dict[str, Coordinate]:
        """Slices of q, v and a by owner, in the order of `coordinate_owners`."""
        found, k = {}, 0
        for named in coordinate_owners(links):
            part = range(k, k := k + len(named.freedoms))
            found[named.owner] = Coordinate(*(rows_of(of, part) for of in (self.q, self.v, self.a)))
        return found

    def quantities(self, scene: Scene) -> dict[str, Values]:
        """Values of all quantities by owner and label; an angle is a tuple of turns."""
        return {
            owner: {
                label: self._turns(scene, Place(owner, label), expected)
                if expected.unit == "rad"
                else value_at(Place(owner, label), expected, self.names, literal, FUNCTIONS)
                for label, expected in quantities.items()
            }
            for owner, quantities in owners(scene)
        }

    def _turns(self, scene: Scene, place: Place, expected: Expected) -> tuple[Turn, ...]:
        angle = angle_at(scene, place, expected)
        found: list[Turn] = [
            Turn(
                self.cosine[self.index[name]],
                (1.0 if count > 0 else -1.0) * self.sine[self.index[name]],
            )
            for name, count in angle.multiples.items()
            for _ in range(abs(count))
        ]
        for tangent, count in angle.arctangents.items():
            r = evaluate(tangent, self.names, literal, FUNCTIONS)
            square = r * r
            cosine = (1 - square) / (1 + square)
            sine = (1.0 if count > 0 else -1.0) * (2 * r / (1 + square))
            found += [Turn(cosine, sine)] * (abs(count) // 2)
        if angle.constant != 0.0:
            found.append(Turn(*cosine_sine(angle.constant)))
        return tuple(found)

    def angle(self, scene: Scene, place: Place, expected: Expected) -> Any:
        """The angle itself (rad), a function of p."""
        angle = angle_at(scene, place, expected)
        turns = [count * self.names[name] for name, count in angle.multiples.items()]
        turns += [
            count * ca.atan(evaluate(tangent, self.names, literal, FUNCTIONS))
            for tangent, count in angle.arctangents.items()
        ]
        return sum(turns, start=ca.SX(angle.constant))

    def evaluate(self, expression: ca.SX) -> list[Array]:
        """Values of an expression of the parameters, at nominal and at random points."""
        rounded = ca.densify(in_doubles(expression))
        function = ca.Function("values", [self.p, self.cosine, self.sine], [rounded])
        points = [np.array([parameter.nominal for parameter in self.parameters])]
        if self.parameters:
            inside = random(self.parameters, _POINTS, 0)
            points += list(np.stack([inside[p.name] for p in self.parameters], axis=1))
        factors = np.array([parameter.factor for parameter in self.parameters])
        return [
            function(point, np.cos(factors * point), np.sin(factors * point)).full()
            for point in points
        ]
