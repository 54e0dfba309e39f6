"""Random mechanisms with all at once against their equations in maximal coordinates, in 150 digits.

`tests/cross/mixed_mechanisms.py` draws trees and all kinds of closed loops with rotors at steady rates,
centers of mass anywhere, gears, springs, struts, imposed motions and frames that spin. Each entry is
right to a hundred roundings of its terms and of the LFT, and to 1e-10 where those are not far larger.
"""

import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.optimize import minimize_scalar

import mbdlft
from mbdlft import MbdlftError, WellPosednessError, to_lft
from mbdlft.base.array import Array
from mbdlft.base.parameter import deltas_at
from mbdlft.lft.sampling import rounding_sizes
from tests.close import EPS
from tests.cross.maximal_model import MISSED, fault, linear_model
from tests.cross.mixed_mechanisms import mixed

RIGHT, ROUNDINGS = 1e-10, 100.0
_NEGLIGIBLE = 1e-8  # of the row or column: a smaller entry is compared with that
_BESIDE = 1.0 - 1e-6  # of the way to a singular point, where the truth has no value
_GROWN = 1e-3  # the nominal value over one that has no bound where six digits of the point say so


def attack(seed: int, folder: Path) -> str:
    """Build a model and compare it where the truth is known: at nominal, inside, and at a corner."""
    return answer(mixed(seed), seed)


def answer(scene: mbdlft.Scene, seed: int, sums: Sequence[str] = ()) -> str:
    """What came of one mechanism; of the trim `sums` are known as sums only, and not compared."""
    try:
        model = to_lft(scene, search=0.0, prove=0.0)
    except WellPosednessError as error:
        if is_singular(scene, str(error)):
            return "refused"
        raise AssertionError(f"{scene.name}: refused where the truth has bounds") from error
    except MbdlftError:
        if fault(scene, points_of(scene, seed)[0]):
            return "refused"
        raise
    error, _ = check(scene, model, points_of(scene, seed), sums)
    return "right" if error <= RIGHT else "rounded"


def is_singular(scene: mbdlft.Scene, message: str) -> bool:
    """Whether a load of the trim or an entry of the truth grows without bound where a message says."""
    narrow = [replace(p, **_around(p)) for p in scene.parameters]
    model = to_lft(scene.model_copy(update={"parameters": tuple(narrow)}), search=0.0, prove=0.0)
    nominal = points_of(scene, 0)[0]
    told = {name: re.search(rf"\b{name} = (-?[\d.e+-]+)", message) for name in nominal}
    assert all(told.values()), message

    def sizes(share: float) -> Array:
        point = {name: x + share * (float(told[name][1]) - x) for name, x in nominal.items()}
        truth = linear_model(scene, point, model)
        loads = max(map(abs, truth.trim.values()), default=0.0)
        return np.maximum([np.max(np.abs(truth.matrix)), loads], 1.0)

    def inverse(share: float) -> float:
        return float(np.min(before / sizes(share)))

    before = sizes(0.0)
    if "between the nominal values and" not in message:
        return inverse(_BESIDE) < _GROWN
    shares = np.linspace(0.0, 1.0, 33)
    k = int(np.argmin([inverse(share) for share in shares]))
    ends = (shares[max(k - 1, 0)], shares[min(k + 1, 32)])
    return bool(minimize_scalar(inverse, bounds=ends, method="bounded").fun < _GROWN)


def _around(parameter: mbdlft.Parameter) -> dict[str, float]:
    reach = 1e-3 * (parameter.high - parameter.low)
    return {"low": parameter.nominal - reach, "high": parameter.nominal + reach}


def points_of(scene: mbdlft.Scene, seed: int) -> list[dict[str, float]]:
    random = np.random.default_rng(seed)
    return [
        {p.name: p.nominal for p in scene.parameters},
        {p.name: float(random.uniform(p.low, p.high)) for p in scene.parameters},
        {p.name: float(random.choice([p.low, p.high])) for p in scene.parameters},
    ]


def check(
    scene: mbdlft.Scene, model: mbdlft.LFTModel, points: list[dict[str, float]], sums: Sequence[str] = ()
) -> tuple[float, float]:
    """Largest error relative to entries and the trim, and in roundings of terms: both are small."""
    truths = [linear_model(scene, point, model) for point in points]
    values = [np.block([[v.A, v.B], [v.C, v.D]]) for v in (mbdlft.matrices_at(model, p) for p in points)]
    errors = np.abs(np.array(values) - [truth.matrix for truth in truths])
    states = len(model.states)
    deltas = deltas_at(
        model.parameters, np.array([[p[x.name] for x in model.parameters] for p in points])
    )
    of_lft = rounding_sizes(model.lft, deltas)
    sizes = scale_of(np.maximum([truth.sizes for truth in truths], of_lft), states)
    scale = scale_of(np.abs([truth.matrix for truth in truths]), states)
    scale = np.where(scale > _NEGLIGIBLE * sizes, scale, sizes)  # unless all of its terms cancel
    error, roundings = np.max(errors / scale), np.max(errors / sizes) / EPS
    # forces of closures are signals of the trim, too
    held = [k for k, signal in enumerate(model.trim.signals) if signal.name in truths[0].trim]
    assert len(held) == len(truths[0].trim)
    held = [k for k in held if model.trim.signals[k].name not in sums]
    trims = np.array([np.ravel(mbdlft.trim_at(model, point))[held] for point in points])
    names = [model.trim.signals[k].name for k in held]
    wanted = np.array([[truth.trim[name] for name in names] for truth in truths])
    of_trim = np.max(np.abs(trims - wanted), initial=0.0) / np.max(np.abs(wanted), initial=1.0)
    assert all(truth.missed < MISSED for truth in truths)
    assert roundings <= ROUNDINGS, f"{scene.name}: {roundings:.1e} roundings, {error:.1e} of an entry"
    # entries whose terms are so much larger have no more digits
    wrong = (errors > RIGHT * scale) & (ROUNDINGS * EPS * sizes <= RIGHT * scale)
    assert not np.any(wrong), f"{scene.name}: {error:.1e} of an entry, {roundings:.1e} roundings"
    assert of_trim <= RIGHT, f"{scene.name}: {of_trim:.1e} of the trim"
    return float(max(error, of_trim)), float(roundings)


def scale_of(sizes: np.ndarray, states: int) -> np.ndarray:
    """Largest of sizes (N, ., .) over the points, or of the row or the column of an input."""
    size = np.max(sizes, axis=0)
    whole = np.repeat(np.max(size[:, :states], axis=1, initial=0.0, keepdims=True), size.shape[1], axis=1)
    whole[:, states:] = np.max(size[:, states:], axis=0, initial=0.0)
    whole = np.where(whole > 0.0, whole, np.max(size))
    return np.where(size > _NEGLIGIBLE * whole, size, whole)
