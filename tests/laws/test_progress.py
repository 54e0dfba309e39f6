"""How far work is: of an upper limit, never backwards, and without a part in the result."""

import time
from pathlib import Path
from typing import Any

import pytest

import mbdlft
from mbdlft.base import running
from mbdlft.cli.output import Progress, progress_of
from mbdlft.system.regular import regularity
from tests.laws.random_loops import blocks_system

SCENARIOS = Path(__file__).parents[2] / "scenarios"
SEARCHES = {
    "margin": lambda model: mbdlft.robust_stability(model, gap=1e-3, work=1.0),
    "gain": lambda model: mbdlft.worst_case_gain(model, "shoulder.torque", "tip.y", work=3.0),
    "poles": lambda model: mbdlft.worst_case(model, "damping", work=2.0),
    "mixed": lambda _: mbdlft.robust_stability(blocks_system(0, 5), work=0.15),
    "stability": lambda model: mbdlft.check_stability(model, 20, prove=2.0),
}


def pendulum() -> mbdlft.LFTModel:
    scene = mbdlft.load_scene(SCENARIOS / "double_pendulum_hanging.toml")
    return mbdlft.to_lft(scene, search=0.0)


@pytest.mark.parametrize("name", SEARCHES)
def test_searches_tell_what_they_have_done(name: str) -> None:
    model, told = pendulum(), list[tuple[float, float]]()
    with running.heard(lambda done, most: told.append((done, most))):
        found = SEARCHES[name](model)
    assert told[0][0] == 0.0
    assert len(told) > 1
    assert len({most for _, most in told}) == 1
    assert all(0.0 <= done <= most for done, most in told)
    best = 0.0
    for done, _ in told:  # parts of a batch begin where the batch began, and never before
        assert done >= 0.5 * best
        best = max(best, done)
    if hasattr(found, "work"):
        assert 0.5 * found.work <= best <= 2.0 * found.work + 1e-3
    again = SEARCHES[name](model)
    assert str(again) == str(found)


def test_a_search_in_another_process_is_heard() -> None:
    scene = mbdlft.load_scene(SCENARIOS / "ur5.toml")
    told: list[tuple[float, float]] = []
    with running.heard(lambda done, most: told.append((done, most))):
        mbdlft.to_lft(scene, search=0.3, prove=0.2)
    by_budget = {most: [done for done, own in told if own == most] for _, most in told}
    assert {0.3, 0.2} <= set(by_budget)
    assert by_budget[0.3] == sorted(by_budget[0.3])
    assert max(by_budget[0.3]) > 0.0


def test_a_proof_tells_what_it_has_done() -> None:
    model, told = pendulum(), list[float]()
    with running.heard(lambda done, most: told.append(done)):
        regularity(model.lft, 0.01)
    assert told
    assert told == sorted(told)


def test_nothing_is_told_where_nobody_listens_and_outside_of_a_budget() -> None:
    running.tell(1.0)
    running.pass_on(1.0, 2.0)
    with running.budget(3.0), running.after(1.0):
        running.tell(1.0)
    told: list[tuple[float, float]] = []
    with running.heard(lambda done, most: told.append((done, most))):
        running.tell(1.0)
        assert told == []
        with running.budget(3.0):
            with running.after(1.0), running.after(0.5), running.budget(7.0):
                running.tell(1.0)
                running.tell(9.0)
            running.pass_on(2.0, 5.0)
        running.pass_on(2.0, 5.0)
    assert told == [(0.0, 3.0), (2.5, 3.0), (3.0, 3.0), (2.0, 3.0), (2.0, 5.0)]


class Line:
    """What is shown, in place of a status of rich."""

    def __init__(self) -> None:
        self.texts: list[str] = []

    def update(self, text: str) -> None:
        self.texts.append(text)


def test_in_a_file_there_is_a_line_now_and_then(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    clock = [100.0]
    monkeypatch.setattr(time, "monotonic", lambda: clock[0])
    with progress_of("[arm]") as progress:
        for done in range(100):
            clock[0] += 1.0
            progress.worked(done, 100.0)
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 5
    assert lines[0] == "[arm], 19 % of the work that is allowed, at most about 1 min left"


def test_a_line_says_stage_share_and_time(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = [100.0]
    monkeypatch.setattr(time, "monotonic", lambda: clock[0])
    line: Any = Line()
    progress = Progress("[arm]", line)
    progress.stage("search")
    progress.worked(0.0, 4.0)
    for _ in range(40):
        clock[0] += 0.05
        progress.worked((clock[0] - 100.0) / 2.0, 4.0)
    assert line.texts[0] == r"\[arm]: search"
    assert line.texts[1] == r"\[arm]: search, 0 % of the work that is allowed"
    assert line.texts[-1].endswith("search, 25 % of the work that is allowed, at most about 6 s left")
    assert len(line.texts) < 25  # not at each step
    progress.worked(0.2, 4.0)  # a part that began earlier
    clock[0] += 1.0
    progress.worked(0.3, 4.0)
    assert "25 %" in line.texts[-1]
    progress.stage("prove")
    assert line.texts[-1] == r"\[arm]: prove"
    clock[0] += 1.0
    progress.counted(50, 100)  # 50 of an earlier run
    clock[0] += 10.0
    progress.counted(60, 100)
    assert line.texts[-1] == r"\[arm]: prove, 60 of 100, about 40 s left"
