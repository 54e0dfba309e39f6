"""The command tune, from a task beside a matrix to proofs that are checked again."""

import json
from pathlib import Path

import pytest

from mbdlft.synthesis import load_tuning
from tests.close import CLOSED_FORM, target
from tests.errors.table import MessageError, refused
from tests.laws.test_synthesis import S, transfer
from tests.scenarios.commands import Call, Output

MODEL = """
format = "mbdlft-matrix/1"
name = "plant"
states = ["x"]
inputs = ["f"]
outputs = ["y"]
matrix = [["-k", 1], [1, 0]]
[parameters]
k = { nominal = 2.0, percent = 30 }
"""
TASK = """
format = "mbdlft-tuning/1"
model = "model.toml"
connections = [["f", "u"], ["e", "r", "-y"]]
[controller.pi]
kind = "pid"
input = "e"
output = "u"
terms = "PI"
ranges = { kp = [0.0, 50.0], ki = [0.0, 50.0] }
[weights.slow]
numerator = [0.5, 1.0]
denominator = [1.0, 0.01]
[goals.tracking]
kind = "gain"
inputs = "r"
outputs = "e"
after = "slow"
[goals.effort]
kind = "gain"
inputs = ["r"]
outputs = ["u"]
limit = 10.0
hard = true
"""


@pytest.fixture
def task(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    Path("model.toml").write_text(MODEL, encoding="utf-8")
    Path("task.toml").write_text(TASK, encoding="utf-8")
    return Path("task.toml")


def test_a_task_is_tuned_proved_and_checked(task: Path, call: Call, output: Output) -> None:
    out = output("tune", str(task), "-o", "made.h5", "--starts", "1", "--json")
    found = json.loads(out)
    assert found["reached"] is True
    assert set(found["values"]) == {"pi.kp", "pi.ki"}
    for goal in found["goals"]:
        assert goal["least"] <= goal["tuned"] <= goal["worst"] <= goal["proved"] <= 1.02 * goal["tuned"]
    code, out, _ = call("verify", "made.h5")
    assert (code, out.count(": proved")) == (0, 2)
    assert "from r to weighted e is at most" in out


def test_weights_are_the_transfer_functions_of_their_coefficients(task: Path) -> None:
    weight = load_tuning(task).goals[0].after
    assert weight is not None
    target(transfer(weight), [[(0.5 * S + 1.0) / (S + 0.01)]], CLOSED_FORM)


def test_hard_goals_that_are_missed_are_an_exit_code(task: Path, call: Call) -> None:
    text = TASK.replace("limit = 10.0", "limit = 0.001").replace(
        'after = "slow"', 'after = "slow"\nhard = true'
    )
    task.write_text(text, encoding="utf-8")
    code, out, _ = call("tune", str(task), "--starts", "1", "--no-proof")
    assert code == 1
    assert "hard goal 'effort': not reached" in out


def test_what_is_reached_and_not_proved_is_another_exit_code(task: Path, call: Call) -> None:
    text = MODEL.replace('["-k", 1]', '["b", "k"]').replace(
        "2.0, percent = 30", "0.5, low = 0.1, high = 1"
    )
    Path("model.toml").write_text(
        text + "b = { nominal = -0.5, low = -1.0, high = 0.3 }\n", encoding="utf-8"
    )
    code, out, _ = call("tune", str(task), "--starts", "1", "--workers", "2")
    assert code == 3
    assert "hard goal 'effort': reached 1, proved 1.0" in out
    code, out, _ = call("tune", str(task), "--starts", "1", "--no-proof", "--json")
    assert (code, json.loads(out)["missing"]) == (0, [])


def test_a_loop_that_stays_unstable_is_named_with_its_point(task: Path, call: Call) -> None:
    """x' = b x + g u with a gain g of both signs: no controller is for both."""
    text = MODEL.replace('["-k", 1]', '["b", "k"]').replace("percent = 30", "low = -0.5, high = 2.5")
    Path("model.toml").write_text(
        text + "b = { nominal = -0.5, low = -0.6, high = 0.3 }\n", encoding="utf-8"
    )
    text = TASK.replace('"PI"', '"P"').replace(", ki = [0.0, 50.0]", "").replace("[0.0,", "[-50.0,")
    task.write_text(text, encoding="utf-8")
    code, out, _ = call("tune", str(task), "--starts", "1")
    assert code == 1
    assert "goal 'tracking': the loop is unstable at b " in out


@pytest.fixture
def changed(monkeypatch, call, tmp_path):
    def at(old: str, new: str) -> None:
        assert old in TASK
        monkeypatch.chdir(tmp_path)
        Path("model.toml").write_text(MODEL, encoding="utf-8")
        Path("task.toml").write_text(TASK.replace(old, new), encoding="utf-8")
        code, _, err = call("tune", "task.toml", "--starts", "1", "--no-proof")
        if code == 2:
            raise MessageError(err)

    return at


test_messages = refused(
    r"""
> changed({}) => MessageError:
"tuning/1", "tuning/2" => task.toml: format: expected 'mbdlft-tuning/1'
'model = "model.toml"', '' => task.toml: 'model' is missing
'"model.toml"', '"none.toml"' => none.toml: cannot be read
'"model.toml"', '1' => model: expected the name of a file, got 1
'[["f", "u"], ["e", "r", "-y"]]', '3' => connections: expected lists of names
'"-y"', '"-z"' => unknown output 'z'
'kind = "pid"', 'kind = "pdi"' => controller 'pi': unknown kind 'pdi'. Did you mean 'pid'
'kind = "pid"', '' => controller 'pi': 'kind' is missing: expected gain, pid
'input = "e"', '' => controller 'pi': 'input' is missing
'input = "e"', 'input = 3' => controller 'pi': input: expected a text, got 3
'terms = "PI"', 'term = "PI"' => controller 'pi': unknown key 'term'. Did you mean 'terms'
'terms = "PI"', 'scheduled = 3' => controller 'pi': scheduled: expected names of parameters
'terms = "PI"', 'scheduled = ["q"]' => unknown parameter 'q'
'[0.0, 50.0], ki', '[0.0], ki' => ranges: expected two numbers by name
'after = "slow"', 'after = "slw"' => goal 'tracking': after: unknown weight 'slw'. Did you mean 'slow'
'numerator = [0.5, 1.0]', 'numerator = [0.0, 1.0]' => weight 'slow': numerator: expected numbers
'numerator = [0.5, 1.0]', 'numerator = [1, 0.5, 1.0]' => weight 'slow': the numerator has a higher power
'denominator = [1.0, 0.01]', 'denominator = [1.0, 0.0]' => goal 'tracking': a weight has the pole 0
'limit = 10.0', 'limit = -1.0' => goal 'effort': expected a positive limit
'limit = 10.0', 'limit = "a"' => goal 'effort': limit: expected a finite number
'hard = true', 'hard = 1' => goal 'effort': hard: expected true or false, got 1
'[goals.effort]', '[goals]' => goals: expected tables by name
'outputs = ["u"]', 'outputs = ["v"]' => unknown output 'v'
"""
)
