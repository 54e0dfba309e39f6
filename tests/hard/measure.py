"""Errors of the two ways to a linear model, with 50 digits beside them."""

from typing import NamedTuple

import numpy as np

import mbdlft
from mbdlft.build import choose_signals
from mbdlft.certify import reference_matrices
from mbdlft.scene import assemble
from tests.hard.cases import Case


class Errors(NamedTuple):
    """Of [A B] at one value of the parameters; factors are in units of condition times eps."""

    condition: float
    lft: float
    lft_factor: float
    numeric: float
    numeric_factor: float
    certified: float
    order: int
    states: int


def measure(case: Case) -> Errors:
    """The LFT and the numeric linearization of a case."""
    model = mbdlft.to_lft(case.scene, search=0.0)
    values = mbdlft.matrices_at(model, case.values)
    lft = np.hstack([values.A, values.B])
    equations = assemble(case.scene)
    inputs, outputs = choose_signals(case.scene, equations)
    point = np.array([[case.values[p.name] for p in equations.parameters]])
    numeric = reference_matrices(equations, inputs, outputs, point)[0][0, : len(lft)]
    truth = case.truth().of_inputs(len(model.inputs))
    return Errors(
        truth.condition,
        truth.error(lft),
        truth.factor(lft),
        truth.error(numeric),
        truth.factor(numeric),
        model.certificate.max_relative_error,
        model.order,
        len(model.states),
    )
