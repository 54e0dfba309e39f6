"""The rates of nonlinear equations of motion, beside those of their linear model."""

from collections.abc import Callable

import casadi as ca
import numpy as np

import mbdlft
from mbdlft import LFTModel, Scene
from mbdlft.base.array import Array
from mbdlft.multibody.motion.equations import Motion, equations_of_motion
from tests.close import CLOSED_FORM

_WEIGHT = 0.1  # 1e-2 g: its rounding stays where little changes


def check_second_order(scene: Scene, model: LFTModel, seed: int) -> None:
    """Rates and outputs of small motions differ from those of the model by what is of second order."""
    random = np.random.default_rng(seed)
    values = {p.name: 0.7 * p.nominal + 0.3 * p.high for p in scene.parameters}
    (A, B, C, D), m = mbdlft.matrices_at(model, values), equations_of_motion(scene, values)
    x, u = (random.standard_normal(M.shape[1]) for M in (A, B))
    known = [y.name for y in m.outputs]
    rows = [k for k, y in enumerate(model.outputs) if y.name in known]
    read = [known.index(model.outputs[k].name) for k in rows]
    names, inputs = ([signal.name for signal in signals] for signals in (m.coordinates, m.inputs))
    chosen = [names.index(state.name) for state in model.states]  # without cyclic ones
    every, rates = np.zeros(len(inputs)), explicit(m)
    sizes = [np.max(np.abs(M) @ np.abs(u)) for M in (B, D[rows]) if np.any(M)]
    u *= 100.0 / max(min(sizes, default=1.0), 1e-3)  # or what is of second order is rounding
    for signal, value in zip(model.inputs, u, strict=True):
        every[inputs.index(signal.name)] = value
    cases = ((x, 0.0 * every, (A, C[rows]), x), (0.0 * x, every, (B, D[rows]), u))
    for state, forces, matrices, v in cases:
        found = [rates(chosen, read, size * state, size * forces) for size in (1e-3, 1e-4)]
        for M, *moved in zip(matrices, *found, strict=True):
            expected, scale = M @ v, np.abs(M) @ np.abs(v)
            if not np.any(scale):
                continue
            scale = np.maximum(scale, max(1e-3 * np.max(scale), _WEIGHT))
            errors = [
                np.max(np.abs(now / size - expected) / scale)
                for now, size in zip(moved, (1e-3, 1e-4), strict=True)
            ]
            assert errors[1] <= max(errors[0] / 8.0, 1e5 * CLOSED_FORM)


def explicit(m: Motion) -> Callable[[list[int], list[int], Array, Array], tuple[Array, Array]]:
    """Rates (k,) of states and outputs at positions, by values of the states and inputs; others fit."""
    still = np.tile([1.0, 0.0, 0.0, 0.0], len(m.balls))
    fitting = [m.constraints, ca.jacobian(m.constraints, m.x)]
    moving = [m.rates, ca.jacobian(m.rates, m.z), m.residual, ca.jacobian(m.residual, m.z)]
    fit = ca.Function("fit", [m.x, m.u, m.references], [ca.densify(y) for y in fitting])
    read = ca.Function("y", [m.x, m.z, m.u, m.references], [ca.densify(m.y)])
    move = ca.Function("move", [m.x, m.z, m.u, m.references], [ca.densify(y) for y in moving])

    def rates(chosen: list[int], outputs: list[int], values: Array, u: Array) -> tuple[Array, Array]:
        x = np.zeros(m.x.numel())
        others = list(m.followers)
        x[chosen] = values
        for _ in range(8 if others else 0):
            gaps, slopes = (np.array(y.full()) for y in fit(x, u, still))
            x[others] -= np.linalg.solve(slopes[:, others], gaps[:, 0])
        at = move(x, 0.0, u, still)
        first, of_z, missing, slopes = (np.array(y.full()) for y in at)
        z = -np.linalg.solve(slopes, missing)
        y = np.asarray(read(x, z, u, still).full())
        return np.asarray((first + of_z @ z)[chosen, 0]), y[outputs, 0]

    return rates
