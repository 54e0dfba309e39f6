"""A few attacks of each class; `make attack` runs them for as long as you like."""

import time
from collections.abc import Iterator, Sequence
from importlib import import_module
from itertools import repeat

import pytest

from tests.attack import CLASSES
from tests.attack.run import Attacker, Tally, command, once, tally

SLOW = {"proofs": (66, 1488)}  # seeds that were wrong


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
