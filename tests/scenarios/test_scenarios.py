"""Every scenario builds, is exact, and says what its file promises."""

from pathlib import Path

import pytest

import mbdlft
from benchmarks import arm as benchmark
from benchmarks import orders as orders_benchmark
from benchmarks.cases.orders import CASES
from mbdlft.multibody.body import ElasticBody
from scenarios import two_link_arm
from tests.close import ELASTIC, SCENARIO, exact

ROOT = Path(__file__).parents[2]
FILES = sorted((ROOT / "scenarios").glob("*.toml"))
MATRICES = [path for path in FILES if "mbdlft-matrix" in path.read_text(encoding="utf-8")]
SCENES = [path for path in FILES if path not in MATRICES]


@pytest.mark.parametrize("path", SCENES, ids=lambda path: path.stem)
def test_scenario_is_exact(path: Path) -> None:
    scene = mbdlft.load_scene(path)
    model = mbdlft.to_lft(scene, search=0.0)
    assert scene.name == path.stem
    assert scene.description
    flexible = any(isinstance(body, ElasticBody) for body in scene.bodies)
    assert model.certificate.max_relative_error <= (ELASTIC if flexible else SCENARIO)
    # at many points in doubles, or at three in 50 digits
    assert model.certificate.check_points >= 100 or model.certificate.check_points in (
        3,
        4,
    )  # in 50 digits
    assert model.order >= sum(model.certificate.lower_bound)
    assert model.certificate.exact


@pytest.mark.parametrize("path", SCENES, ids=lambda path: path.stem)
def test_toml_to_python_and_back_is_equal(path: Path) -> None:
    scene = mbdlft.load_scene(path)
    text = mbdlft.scene_to_toml(scene)
    assert mbdlft.scene_from_toml(text) == scene
    assert mbdlft.scene_to_toml(mbdlft.scene_from_toml(text)) == text


@pytest.mark.parametrize("path", MATRICES, ids=lambda path: path.stem)
def test_matrix_scenario_is_exact_and_makes_the_round_trip(path: Path) -> None:
    problem = mbdlft.load_matrix(path)
    model = mbdlft.realize(problem, search=0.0)
    assert problem.name == path.stem
    assert problem.description
    assert model.certificate.max_relative_error <= SCENARIO
    assert model.order >= sum(model.certificate.lower_bound)
    text = mbdlft.matrix_to_toml(problem)
    assert text == model.provenance.scene
    assert mbdlft.matrix_from_toml(text) == problem
    assert mbdlft.matrix_to_toml(mbdlft.matrix_from_toml(text)) == text


def test_matrix_scenarios_have_their_orders() -> None:
    aircraft = mbdlft.realize(
        mbdlft.load_matrix(ROOT / "scenarios" / "lateral_aircraft.toml"), search=0.0
    )
    assert aircraft.order == 14
    assert aircraft.certificate.minimal
    missile = mbdlft.load_matrix(ROOT / "scenarios" / "missile.toml")
    model = mbdlft.realize(missile, search=20.0)
    assert model.certificate.lower_bound == (4, 5, 1)
    assert model.order == 10
    assert model.certificate.minimal
    assert model.certificate.exact_bound


def test_arm_in_python_equals_arm_in_toml() -> None:
    from_toml = mbdlft.load_scene(ROOT / "scenarios" / "two_link_arm.toml")
    in_python = two_link_arm.scene()
    assert in_python == from_toml
    a, b = mbdlft.to_lft(from_toml, search=0.0), mbdlft.to_lft(in_python, search=0.0)
    assert a.lft.blocks == b.lft.blocks
    for name in ("M11", "M12", "M21", "M22"):
        exact(getattr(a.lft, name), getattr(b.lft, name))
    assert a.certificate == b.certificate
    assert a.trim.nominal == b.trim.nominal


def test_batch_script_prints_its_table(capsys: pytest.CaptureFixture[str]) -> None:
    two_link_arm.main()
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 1 + 12
    # theta1 = 90, theta2 = 90 deg: the outer link is level, the torques are those of its weight
    weight = 9.81 * (2.0 * 0.5 + 5.0)
    values = lines[8 + 3].split()
    assert values[:4] == ["90.0", "90.0", f"{-weight:.4f}", f"{-weight:.4f}"]


@pytest.mark.long
def test_benchmark_at_its_smallest() -> None:
    found = benchmark.rows(repeats=1, step=45.0)
    text = benchmark.table(found)
    assert text.count("\n") == len(found) + 3
    timed = ("median",)
    for row in found:
        if not any(word in row.what for word in timed) and "of which" not in row.what:
            assert row.met, row


def test_orders_benchmark_at_its_smallest() -> None:
    rows = [orders_benchmark.measure(case, 0.0) for case in CASES if case.name in ("O4", "O9")]
    assert [row.searched for row in rows] == [row.bound for row in rows] == [2, 3]
    assert orders_benchmark.table(rows).count("\n") == len(rows) + 3
    chains = [orders_benchmark.measure_chain(2, spatial=False, search=10.0)]
    assert (chains[0].plain, chains[0].searched, chains[0].bound) == (16, 15, 15)
    assert orders_benchmark.chain_table(chains).count("\n") == len(chains) + 1
