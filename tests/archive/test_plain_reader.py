"""The plain reader against mbdlft; and with one rule of the format left out, which must disagree."""

import numpy as np
import pytest

from mbdlft import matrices_at, random, save
from mbdlft.system.sampled import deltas_of
from tests.archive import models, plain_reader
from tests.close import roundoff

MODELS = {"arm": models.arm, "turned arm": models.turned_arm, "unused": models.unused}
POINTS = 20


def compare(file, model, check):
    """Compare A of both readers at random points with `check(plain, of mbdlft, condition)`."""
    samples = random(model.parameters, POINTS, seed=1)
    spread = np.repeat(deltas_of(model, samples), [b.size for b in model.lft.blocks], axis=1)
    for k in range(POINTS):
        values = {name: float(column[k]) for name, column in samples.items()}
        plain = plain_reader.state_matrix(file, model.name, values)
        kappa = np.linalg.cond(np.eye(model.order) - model.D_zw * spread[k])
        check(plain, matrices_at(model, values).A, kappa)


@pytest.mark.parametrize("make", MODELS.values(), ids=MODELS.keys())
def test_agreement(tmp_path, make):
    save(tmp_path / "a.h5", make())
    compare(tmp_path / "a.h5", make(), roundoff)


def test_agreement_without_parameters(tmp_path):
    save(tmp_path / "a.h5", models.bare())
    roundoff(plain_reader.state_matrix(tmp_path / "a.h5", "bare", {}), models.bare().A)


def test_nominal(tmp_path):
    save(tmp_path / "a.h5", models.arm())
    roundoff(plain_reader.state_matrix(tmp_path / "a.h5", "two_link_arm", {}), models.arm().A)
