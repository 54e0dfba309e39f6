"""Errors of the two ways to a linear model, with 50 digits beside them."""

from typing import NamedTuple

import numpy as np

import mbdlft
from benchmarks.cases.hard import Case
from benchmarks.targets import EPS
from mbdlft.base.samples import check_points
from mbdlft.multibody.assembly import assemble
from mbdlft.multibody.to_problem import choose_signals
from mbdlft.problem.linearization import relinearize
from mbdlft.problem.references import entry_scale


class Errors(NamedTuple):
    """Of [A B] at one value of the parameters; factors are in units of condition times eps.

    `certified`, `stated` (a condition) and `sign_changes` are what the certificate says; `unstated`
    is the largest error of an entry in units of the first plus the second times eps: relative to the
    entry itself, unless it changes its sign or is negligible.
    """

    condition: float
    lft: float
    lft_factor: float
    numeric: float
    numeric_factor: float
    certified: float
    stated: float
    sign_changes: int
    unstated: float
    order: int
    states: int


def _own_scale(model: mbdlft.LFTModel, values: np.ndarray) -> np.ndarray:
    """What an entry of [A B] is relative to, by the definition of the condition of the certificate."""
    points = check_points(model.parameters, model.certificate.seed)
    sampled = mbdlft.matrices_at(model, {p.name: points[:, k] for k, p in enumerate(model.parameters)})
    samples = np.concatenate([sampled.A, sampled.B], axis=2)
    scale = entry_scale(samples, len(model.states))
    one_sign = np.all(samples > 0.0, axis=0) | np.all(samples < 0.0, axis=0)
    own = one_sign & (np.max(np.abs(samples), axis=0) >= scale)
    return np.where(own, np.abs(values), scale)


def measure(case: Case) -> Errors:
    """The LFT and the numeric linearization of a case."""
    model = mbdlft.to_lft(case.scene, search=0.0)
    values = mbdlft.matrices_at(model, case.values)
    lft = np.hstack([values.A, values.B])
    equations = assemble(case.scene)
    inputs, outputs = choose_signals(case.scene, equations)
    point = np.array([[case.values[p.name] for p in equations.parameters]])
    numeric = relinearize(equations, inputs, outputs, point).linear.matrices[0, : len(lft)]
    truth = case.truth().of_inputs(len(model.inputs))
    certificate = model.certificate
    stated = certificate.max_relative_error + EPS * certificate.condition
    return Errors(
        truth.condition,
        truth.error(lft),
        truth.factor(lft),
        truth.error(numeric),
        truth.factor(numeric),
        certificate.max_relative_error,
        certificate.condition,
        certificate.sign_changes,
        float(np.max(np.abs(lft - truth.values) / _own_scale(model, truth.values))) / stated,
        model.order,
        len(model.states),
    )
