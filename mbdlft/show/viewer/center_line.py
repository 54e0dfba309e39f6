"""The deformed center line of a beam, at its nodes or at as many points as its modes need."""

import casadi as ca
import numpy as np

from mbdlft.base.description import Values
from mbdlft.multibody.body import Beam
from mbdlft.multibody.body.beam_elements import values_at

_POINTS = 24  # at least, for polynomials over the whole beam
_ROW = {
    "axial": 0,
    "bending_y": 1,
    "bending_z": 2,
}  # of the displacement that each deformation makes


def center_line(beam: Beam, values: Values, q: ca.SX) -> list[ca.SX]:
    """Points (3,) from the origin to the tip, in the axes of the body (m), for coordinates q (n,)."""
    finer = 1 if beam.modes is None else -(-_POINTS // beam.elements)
    count = beam.elements * finer
    points = [ca.SX(3, 1)]
    for node in range(1, count + 1):
        moved = np.zeros((3, len(beam.freedoms())))
        for name, d, part in beam.blocks():
            if name in _ROW:
                fine = d._replace(elements=count, breaks=tuple(finer * k for k in d.breaks))
                moved[_ROW[name], part] = values_at(fine, "displacement", node)
        along = ca.vertcat(ca.SX(node / count * values["length"]), ca.SX(2, 1))
        points.append(along + ca.mtimes(ca.SX(moved), q))
    return points
