"""Structure and controller together: goals on design parameters, and the spacecraft of the thesis."""

import json
from pathlib import Path

import numpy as np

import mbdlft
from mbdlft.library import band_pass, low_pass
from mbdlft.synthesis import design_goal, designed_scene, gain_goal, tune
from mbdlft.synthesis.codesign import budgets
from mbdlft.synthesis.loop import network
from tests.close import CLOSED_FORM, FITTED, target
from tests.scenarios.commands import Output

FOLDER = Path(__file__).parents[2] / "scenarios" / "tasks"
DESIGNED = mbdlft.realize(
    [["-1-b", "1"], ["a", "0"]],
    [mbdlft.Parameter(name, 1.0, low=0.5, high=2.0, role="design") for name in "ab"],
    states=1, inputs=["f"], outputs=["y"], name="P", search=0.0, prove=0.0,
)  # fmt: skip


def test_an_expression_of_design_parameters_and_its_slope() -> None:
    """f = a/b + a b^2 - 1; df/ddelta by the slope of the map from delta to the parameter."""
    goal = design_goal("a/b + a*b^2 - 1", 2.0)
    found = budgets(network([DESIGNED], [], [goal, gain_goal("f", "y")]), [goal])[0]
    x, step = np.array([0.3, -0.4]), 1e-6

    def physical(delta: float) -> float:  # -1, 0, 1 at 0.5, 1, 2: (1 + delta/3)/(1 - delta/3)
        return (1.0 + delta / 3.0) / (1.0 - delta / 3.0)

    a, b = map(physical, x)
    rates = [(physical(d + step) - physical(d - step)) / (2.0 * step) for d in x]
    value, slope = found.at(x)
    target([value], [0.5 * (a / b + a * b**2 - 1.0)], CLOSED_FORM)
    expected = [0.5 * (1.0 / b + b**2) * rates[0], 0.5 * (2.0 * a * b - a / b**2) * rates[1]]
    target(slope, expected, FITTED)


def test_a_budget_and_a_size_meet() -> None:
    """Of 1/a and (a + b)/2 the larger one is least where b = 0.5 and 1/a = (a + 0.5)/2."""
    goals = [
        design_goal("1/a", 1.0, name="size"),
        design_goal("a + b", 2.0),
        gain_goal("f", "y", limit=9.0),
    ]
    made = tune([DESIGNED], goals, [], starts=1)
    a = 0.25 * (np.sqrt(33.0) - 1.0)
    target([made.values["a"], made.values["b"], made.soft], [a, 0.5, 1.0 / a], FITTED)
    assert made.goals[0].proved == made.goals[0].worst


def test_the_spacecraft_is_designed_with_its_controllers(tmp_path: Path, output: Output) -> None:
    """Table 8.1 of the thesis, and the design in finer elements behind a wheel and an amplifier."""
    task, scene, archive = FOLDER / "rotatory_spacecraft.toml", tmp_path / "new.toml", tmp_path / "new.h5"
    how = ("-o", str(archive), "--scene", str(scene), "--starts", "1", "--no-proof", "--json")
    text = output("tune", str(task), *how)
    out = json.loads(text)
    v = out["values"]
    shares = {n: (v[n] / (1.2192 if n[0] == "L" else 2.290382) - 1.0) / 0.3 for n in v if n[0] in "LM"}
    assert min(shares["L1"], shares["M1"]) >= 0.95
    assert max(shares["M2"], shares["M4"]) <= -0.9
    mass = sum(v[f"M{k}"] + 1.3017 * v[f"L{k}"] for k in range(1, 5))
    assert mass <= 15.9
    hub = next(goal for goal in out["goals"] if goal["name"] == "hub")
    assert 1.05 * hub["worst"] <= 1.05
    # the scene that was written has the design as nominal values; the same with three elements a beam
    new = mbdlft.load_scene(scene)
    target([p.nominal for p in new.parameters], [v[p.name] for p in new.parameters], CLOSED_FORM)
    coarse = (FOLDER / "rotatory_codesign.toml").read_text(encoding="utf-8")
    fine = coarse.replace("elements = 1", "elements = 3").replace("end = 1", "end = 3")
    body = mbdlft.to_lft(designed_scene(mbdlft.scene_from_toml(fine), v), search=0.0)
    assert len(body.states) == 50
    parts = [
        body, mbdlft.load(archive, "pd"), mbdlft.load(archive, "patch"),
        low_pass(20.0 * np.pi, name="wheel"), band_pass(0.2 * np.pi, 2e3 * np.pi, name="amplifier"),
    ]  # fmt: skip
    wired = [
        ["pd.angle", "pin.angle"], ["pd.rate", "pin.rate"], ["wheel.command", "pd.torque"],
        ["patch.acceleration", "tip.y"], ["amplifier.command", "patch.voltage"],
        ["beam1.voltage.1", "amplifier.output"],
    ]  # fmt: skip
    opened = mbdlft.connect(parts, wired, inputs=["pin.torque"], outputs=["wheel.output"])
    A, B, C, _ = mbdlft.matrices_at(opened, {})
    assert np.max(np.linalg.eigvals(A + B @ C).real) < -1e-3
    omega = np.geomspace(0.05, 100.0, 100_000)
    L = -np.squeeze(mbdlft.frequency_response(opened, {}, omega))
    crossed = np.flatnonzero(np.diff(np.sign(np.abs(L) - 1.0)))
    assert np.degrees(np.min(np.abs(np.angle(-L[crossed])))) >= 60.0
