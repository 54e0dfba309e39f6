"""A few attacks of each class; `make attack` runs them for as long as you like."""

import time
from collections.abc import Iterator, Sequence
from importlib import import_module
from itertools import repeat
from pathlib import Path

import numpy as np
import pytest

import mbdlft
from mbdlft import WellPosednessError, to_lft
from tests import kit
from tests.attack import CLASSES, contacts, cores, mechanisms
from tests.attack.run import Attacker, Tally, command, once, tally

# seeds that were wrong, and more of what no other test draws at random
SLOW = {
    "proofs": (66, 1488),
    "couplings": range(30),
    "contacts": range(30),
    "claims": (0,),
    "sparse": (0,),
    "frames": (5,),
    "empty": (7,),
    "accelerations": (1, 2),
}


@pytest.fixture(scope="module")
def attacker() -> Iterator[Attacker]:
    process = Attacker()
    yield process
    process.end()


@pytest.mark.parametrize("name", [*filter(CLASSES.get, CLASSES)])
def test_attacks(name: str, attacker: Attacker) -> None:
    check(attacker, name, CLASSES[name])


@pytest.mark.long
@pytest.mark.parametrize("name", CLASSES)
def test_more_attacks(name: str, attacker: Attacker) -> None:
    check(attacker, name, [*range(100, 120), *SLOW.get(name, ())])


def check(attacker: Attacker, name: str, seeds: Sequence[int]) -> None:
    said: list[str] = []
    found = tally(attacker, name, seeds, time.monotonic() + 3600.0, said.append)
    assert not found.failed, "\n".join(said)
    assert sum(found.counts.values()) == len(seeds) > 0


def test_a_failure_a_hang_and_a_dead_process_are_told(
    attacker: Attacker, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tests.attack.run.SECONDS", 0.3)
    said: list[str] = []
    found = tally(attacker, "planted", [0, 1, 2, 3, 0], time.monotonic() + 3600.0, said.append)
    assert found.counts == {"refused": 2}
    assert "ZeroDivisionError" in found.failed[1]
    assert found.failed[2] == "it hangs"
    assert found.failed[3] == "it ended the process (7)"
    assert "3 FAILED" in found.line()
    assert found.slowest[1] == 2
    assert [line.splitlines()[0] for line in said] == [
        f"FAILED {command('planted', seed)}" for seed in (1, 2, 3)
    ]


def test_the_end_of_the_time_is_the_end() -> None:
    assert tally(Attacker(), "planted", repeat(0), time.monotonic()).counts == {}
    assert Tally("x").line() == "x: 0 attacks: none; slowest 0.0 s (seed 0); 0 failed"


def test_each_class_is_a_file() -> None:
    for name in CLASSES:
        assert callable(import_module(f"tests.attack.{name.replace('-', '_')}").attack)


@pytest.mark.parametrize("seed", [45, 770031])
def test_matrices_whose_values_take_more_bits_are_not_refused(seed: int) -> None:
    """Balls of 384 bits lost their values, and a regular matrix was called singular."""
    assert once("matrices", seed) == "canceling exact"


@pytest.mark.parametrize("what", ["said", "order", "values"])
def test_kernels_that_differ_are_told(what: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
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
