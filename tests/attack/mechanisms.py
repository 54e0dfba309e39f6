"""Random mechanisms with all at once against their equations in maximal coordinates, in 150 digits.

`tests/cross/mixed_mechanisms.py` draws trees and all kinds of closed loops with rotors at steady rates,
centers of mass anywhere, gears, springs, struts, imposed motions and frames that spin. Models are right
to 1e-10 of each entry, and to a hundred roundings of its terms.
"""

from pathlib import Path

import numpy as np

import mbdlft
from mbdlft import WellPosednessError, to_lft
from tests.close import EPS
from tests.cross.maximal_model import linear_model
from tests.cross.mixed_mechanisms import mixed

RIGHT, ROUNDINGS = 1e-10, 100.0
_NEGLIGIBLE = 1e-8  # of the row or column: a smaller entry is compared with that


def attack(seed: int, folder: Path) -> str:
    """Build a model and compare it where the truth is known: at nominal, inside, and at a corner."""
    scene = mixed(seed)
    try:
        model = to_lft(scene, search=0.0, prove=0.0)
    except WellPosednessError:
        return "refused"
    check(scene, model, points_of(scene, seed))
    return "right"


def points_of(scene: mbdlft.Scene, seed: int) -> list[dict[str, float]]:
    random = np.random.default_rng(seed)
    return [
        {p.name: p.nominal for p in scene.parameters},
        {p.name: float(random.uniform(p.low, p.high)) for p in scene.parameters},
        {p.name: float(random.choice([p.low, p.high])) for p in scene.parameters},
    ]


def check(
    scene: mbdlft.Scene, model: mbdlft.LFTModel, points: list[dict[str, float]]
) -> tuple[float, float]:
    """Largest error relative to entries and the trim, and in roundings of terms: both are small."""
    truths = [linear_model(scene, point, model) for point in points]
    values = [np.block([[v.A, v.B], [v.C, v.D]]) for v in (mbdlft.matrices_at(model, p) for p in points)]
    errors = np.abs(np.array(values) - [truth.matrix for truth in truths])
    states = len(model.states)
    sizes = scale_of([truth.sizes for truth in truths], states)
    scale = scale_of([np.abs(truth.matrix) for truth in truths], states)
    scale = np.where(scale > _NEGLIGIBLE * sizes, scale, sizes)  # unless all of its terms cancel
    error, roundings = np.max(errors / scale), np.max(errors / sizes) / EPS
    # forces of closures are signals of the trim, too
    held = [k for k, signal in enumerate(model.trim.signals) if signal.name in truths[0].trim]
    assert len(held) == len(truths[0].trim)
    trims = np.array([np.ravel(mbdlft.trim_at(model, point))[held] for point in points])
    names = [model.trim.signals[k].name for k in held]
    wanted = np.array([[truth.trim[name] for name in names] for truth in truths])
    of_trim = np.max(np.abs(trims - wanted), initial=0.0) / np.max(np.abs(wanted), initial=1.0)
    assert all(truth.missed < RIGHT for truth in truths)
    assert error <= RIGHT, f"{scene.name}: {error:.1e} of an entry, {roundings:.1e} roundings"
    assert roundings <= ROUNDINGS, f"{scene.name}: {roundings:.1e} roundings, {error:.1e} of an entry"
    assert of_trim <= RIGHT, f"{scene.name}: {of_trim:.1e} of the trim"
    return float(max(error, of_trim)), float(roundings)


def scale_of(sizes: list[np.ndarray], states: int) -> np.ndarray:
    """Largest sizes (., .) over the points; of the row, or of the column of an input, if negligible."""
    size = np.max(sizes, axis=0)
    whole = np.repeat(np.max(size[:, :states], axis=1, initial=0.0, keepdims=True), size.shape[1], axis=1)
    whole[:, states:] = np.max(size[:, states:], axis=0, initial=0.0)
    whole = np.where(whole > 0.0, whole, np.max(size))
    return np.where(size > _NEGLIGIBLE * whole, size, whole)
