"""A second reader of the archive, with h5py and numpy only and nothing of mbdlft."""

import h5py
import numpy as np

DIVISOR = {"half-angle": 2.0, "quarter-angle": 4.0}
RADIANS = {"rad": 1.0, "deg": np.pi / 180.0}


def to_internal(value, unit, substitution, reference):
    """Internal value of a physical value: the tangent of a part of an angle."""
    if substitution == "identity":
        return value
    return np.tan((value * RADIANS[unit] - reference) / DIVISOR[substitution])


def to_delta(internal, b0, b1, a1):
    """Inverse of the bilinear map internal = (b0 + b1 delta)/(1 + a1 delta)."""
    return (internal - b0) / (b1 - a1 * internal)


def state_matrix(path, name, values):
    """A at physical values by name, in the units of the file; the others are nominal."""
    with h5py.File(path) as file:
        model = file[f"models/{name}"]
        A, B_w, C_z, D_zw = (model[key][()] for key in ("A", "B_w", "C_z", "D_zw"))
        rows, p = model["delta/parameter"][()], model["parameters"]
        names, units, substitutions = (p[key].asstr()[()] for key in ("name", "unit", "substitution"))
        nominal, reference, maps = (p[key][()] for key in ("nominal", "reference", "map"))
    deltas = np.zeros(len(names))
    for k, key in enumerate(names):
        value = values.get(key, nominal[k])
        internal = to_internal(value, units[k], substitutions[k], reference[k])
        deltas[k] = to_delta(internal, *maps[k])
    delta = deltas[rows]
    return A + B_w * delta @ np.linalg.solve(np.eye(len(rows)) - D_zw * delta, C_z)
