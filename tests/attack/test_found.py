"""Bugs that are planted in the package are found by the attacks that compare with known answers."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mbdlft
from mbdlft import WellPosednessError, to_lft
from mbdlft.archive import program as stored
from mbdlft.base import expression, unit
from mbdlft.dae import branches
from mbdlft.lft.lft import LFT
from mbdlft.order.reduction import reduce_order
from mbdlft.pipeline import certification, forms, stages
from mbdlft.robust import ascent
from mbdlft.robust.bisect import boxes
from tests import kit
from tests.attack import (
    analyses,
    contacts,
    cores,
    equations,
    expressions,
    matrices,
    mechanisms,
    programs,
    scenes,
    switches,
)
from tests.extracted import exactly

Patch = pytest.MonkeyPatch


def found(attack: Callable[[int, Path], str], seeds: range, folder: Path) -> bool:
    """Whether an attack with one of some seeds finds a wrong answer."""
    expression.parse.cache_clear()
    try:
        for seed in seeds:
            attack(seed, folder)
    except AssertionError:
        return True
    finally:
        expression.parse.cache_clear()
    return False


def literals_in_doubles(patch: Patch) -> None:
    patch.setattr(expression, "Literal", float)


def reduction_in_doubles(patch: Patch) -> None:
    patch.setattr(forms, "reduce_exactly", lambda a: exactly(reduce_order(a.rounded())))


def units_in_doubles(patch: Patch) -> None:
    def in_doubles(number: str, of: unit.Unit) -> str:
        return repr(float(number) * of.factor)

    patch.setattr(expression, "in_si", in_doubles)


def a_wrong_entry(patch: Patch) -> None:
    """An output is wrong by a millionth, and the certificate does not see it."""
    right = stages._in_units

    def wrong(*arguments: Any) -> LFT:
        a = right(*arguments)
        return LFT(a.M11, a.M12, a.M21, (1.0 + 1e-6) * a.M22, a.blocks)

    patch.setattr(stages, "_in_units", wrong)
    patch.setattr(
        certification, "measure_error", lambda *_: certification.Checked(0.0, 3, 0.0, (), (), 1.0, 0, 0.0)
    )


def nothing_vanishes(patch: Patch) -> None:
    patch.setattr(boxes, "excludes", lambda piece, gain: True)


def a_wrong_branch(patch: Patch) -> None:
    patch.setitem(branches.SWITCHES, "fmax", branches.SWITCHES["fmin"])  # type: ignore[index]


def programs_unproved(patch: Patch) -> None:
    patch.setattr(stored, "mistake_of", lambda *_: "")


def crossings_too_near(patch: Patch) -> None:
    right = ascent.smallest_crossing

    def wrong(*arguments: Any) -> Any:
        found = right(*arguments)
        return found._replace(size=0.9 * found.size, delta=0.9 * found.delta)

    patch.setattr(ascent, "smallest_crossing", wrong)


@pytest.mark.parametrize(
    ("bug", "attack", "seeds"),
    [
        (nothing_vanishes, analyses.attack, range(3)),
        (crossings_too_near, analyses.attack, range(3)),
        (literals_in_doubles, matrices.attack, range(0, 18, 6)),
        (reduction_in_doubles, matrices.attack, range(3, 21, 6)),
        (a_wrong_entry, matrices.attack, range(3)),
        (units_in_doubles, expressions.attack, range(60)),
        (literals_in_doubles, expressions.attack, range(60)),
        (a_wrong_entry, expressions.attack, range(60)),
        (a_wrong_entry, scenes.attack, range(60)),
        (a_wrong_entry, equations.attack, range(3)),
        (a_wrong_branch, switches.attack, range(25, 26)),
        (programs_unproved, programs.attack, range(2, 3)),
    ],
)
def test_planted_bug_is_found(
    bug: Callable[[Patch], None],
    attack: Callable[[int, Path], str],
    seeds: range,
    monkeypatch: Patch,
    tmp_path: Path,
) -> None:
    bug(monkeypatch)
    assert found(attack, seeds, tmp_path)


@pytest.mark.parametrize("what", ["said", "order", "values"])
def test_kernels_that_differ_are_told(what: str, monkeypatch: Patch, tmp_path: Path) -> None:
    answer = {"word": "scene", "said": [1], "order": [[2], 2, 0], "error": 0.0}
    other = answer | {"values": np.eye(2)[None].tolist()}
    wrong = other | {what: (2.0 * np.eye(2)[None]).tolist()}
    monkeypatch.setattr(cores, "kinds", lambda: ("Prescott",))
    monkeypatch.setattr(cores, "_ask", lambda *_: None)
    monkeypatch.setattr(cores, "answer", lambda seed: other)
    monkeypatch.setattr(cores, "_answer", lambda kind: other)
    assert cores.attack(0, tmp_path) == "scene"
    monkeypatch.setattr(cores, "_answer", lambda kind: wrong)
    with pytest.raises(AssertionError):
        cores.attack(0, tmp_path)


def test_a_refusal_as_singular_is_asked_where_it_says() -> None:
    """A push across a rail that carries a weight has no bound where the rail is upright."""
    scene = kit.scene(
        "hoist",
        mbdlft.Parameter("m", 3.0, low=2.0, high=4.0, unit="kg"),
        mbdlft.Angle("th", 20.0, low=-10.0, high=100.0),
        kit.body("cage", "m", (1.0, 1.0, 1.0)),
        kit.rail(
            "rail", "ground", "cage", (0, 0, 1), orientation=(kit.turn((0, 1, 0), "th"),), preload=0.0
        ),
        kit.force("push", "cage", (1, 0, 0), frame="ground"),
        gravity=(0.0, 0.0, -9.81),
    )
    with pytest.raises(WellPosednessError) as refused:
        to_lft(scene)
    assert mechanisms.is_singular(scene, str(refused.value))
    assert not mechanisms.is_singular(scene, "m = 2 kg, th = 10 deg")


@pytest.mark.long
def test_forces_that_share_a_load_of_the_equilibrium_are_no_outputs(tmp_path: Path) -> None:
    """Wheels and a keel that hold a side force together: who has it decides what each feels in a turn."""
    assert contacts.attack(469, tmp_path) == "right"
