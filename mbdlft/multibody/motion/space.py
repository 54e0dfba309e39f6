"""What loads, contacts and sensors see of bodies at displacements of any size.

A point at r of a body, in its axes, is at x + R r in those of the scene and has the velocity
xdot + w x R r. The frame of what turns at a steady rate does not turn with it: the rate of its angle is
in w, and the angle, which no load or sensor sees, is not in R.
"""

from functools import cached_property

import casadi as ca

from mbdlft.multibody.assembly.kinematics import Motions, View, motions
from mbdlft.multibody.body import GROUND
from mbdlft.multibody.spatial import Small


class LargeView(View):
    """The view of a tree whose motions may have any size; `move` says what they are first."""

    def move(self, q: ca.SX, v: ca.SX, a: ca.SX, qdot: ca.SX) -> None:
        """Displacements, rates and accelerations (n,) of all coordinates, and the rates of q."""
        self.q, self.v, self.a, self.qdot = q, v, a, qdot

    @cached_property
    def _relative(self) -> Motions:
        """Motions relative to the frame of the scene."""
        return motions(self.now, ca.SX(3, 3))

    def rate(self, expression: ca.SX) -> ca.SX:
        """The rate of an expression of q and v."""
        of_q = ca.jtimes(expression, self.q, self.qdot)
        return ca.SX(of_q + ca.jtimes(expression, self.v, self.a))

    def place(self, port: str) -> ca.SX:
        """Place (3,) of a port in the axes of the scene."""
        return self.between(GROUND, port)

    def turned(self, vector: ca.SX, port: str) -> ca.SX:
        """Components (3,) in the axes of the scene of a vector in those of the body of a port."""
        return self.across_now(vector, self.find(port)[0], GROUND)

    def turning(self, port: str) -> ca.SX:
        """Angular velocity (3,) of the body of a port relative to the scene, in its axes."""
        return self.turned(self._relative.bodies[self.find(port)[0]][:, 0], port)

    def velocity_at(self, port: str, arm: ca.SX) -> ca.SX:
        """Velocity (3,) over the scene of the point of a body at `arm` (3,) from a port, in its axes."""
        return ca.SX(self.rate(self.place(port)) + ca.cross(self.turning(port), arm))

    def small(self, port: str, order: int) -> tuple[str, Small]:
        """Displacement and rotation vector 2 tan(angle/2) axis, or velocities, or accelerations."""
        if order == 0:
            moved = self.place(port) - self.between_at_rest(GROUND, port)
            return GROUND, Small(self._rotation(self.find(port)[0]), moved)
        turning, velocity = self.turning(port), self.rate(self.place(port))
        if order == 1:
            return GROUND, Small(turning, velocity)
        return GROUND, Small(self.rate(turning), self.rate(velocity))

    def _rotation(self, body: str) -> ca.SX:
        twice, trace = ca.SX(3, 1), ca.SX(0)
        for e in ca.horzsplit(ca.SX.eye(3)):
            old, new = self.across(e, body, GROUND), self.across_now(e, body, GROUND)
            twice, trace = twice + ca.cross(old, new), trace + ca.dot(old, new)
        return ca.SX(2.0 * twice / (1.0 + trace))
