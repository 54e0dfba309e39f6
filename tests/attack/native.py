"""Random scenes as native code: status and values of the definition, as near to 50 digits as that."""

import warnings
from pathlib import Path

import numpy as np

import mbdlft
from mbdlft import MbdlftError
from mbdlft.batch.native import compiled
from mbdlft.batch.rows import EquationSource, source_of
from mbdlft.multibody.assembly import assembly
from mbdlft.problem.digits import equations_in_digits
from tests.attack.mutations import check_message
from tests.close import EVALUATION, NOTHING
from tests.cross.mechanisms import closed_loop, open_tree
from tests.cross.mixed_mechanisms import mixed
from tests.strategies import random_scene

MAKERS = (random_scene, mixed, open_tree, closed_loop)
SAMPLES, IN_DIGITS = 64, 6
WORSE = 20.0  # times the error of the definition, which refines what it solves


def attack(seed: int, folder: Path) -> str:
    """Compile a scene, and compare its rows at random samples."""
    random = np.random.default_rng(seed)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            scene = MAKERS[int(random.integers(len(MAKERS)))](seed)
            source = source_of(scene)
    except MbdlftError as error:
        check_message(error)
        return "refused"
    assert isinstance(source, EquationSource)
    found = compiled(source, threads=1)
    assert not found.reason, found.reason
    samples = mbdlft.random(source.parameters, SAMPLES, seed)
    points = np.stack([*samples.values()], axis=-1) if samples else np.zeros((1, 0))
    rows, expected = found.rows(points), source.rows(points)
    assert np.array_equal(rows[3], expected[3]), "another status"
    good = np.flatnonzero(expected[3] == 0)[:IN_DIGITS]
    if not len(good):
        return "no sample has a solution"
    exact = assembly(scene).exact
    reference = source.need.of(
        equations_in_digits(exact, source.inputs, source.outputs).matrices(points[good]), points[good]
    )
    size = np.max(np.abs(reference), axis=0)
    size = np.where(size > NOTHING * np.max(size), size, max(np.max(size), NOTHING))
    own, other = (float(np.max(np.abs(x[0][good] - reference) / size)) for x in (rows, expected))
    assert own <= WORSE * other + EVALUATION, f"error {own:.1e}, that of the definition {other:.1e}"
    return "equal"
