"""Every catalogue body loads, is what its script makes, and can be used in a scene."""

import tomllib
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import mbdlft
from bodies import solar_panel
from mbdlft.cli.commands import app
from mbdlft.elastic.catalogue import reduced_body
from mbdlft.multibody.scene.toml import body_to_toml
from tests import kit
from tests.close import SCENARIO, exact, roundoff

ROOT = Path(__file__).parents[2]
FILES = sorted((ROOT / "bodies").glob("*.toml"))
PANEL = ROOT / "bodies" / "solar_panel.toml"


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_body_is_described_and_loads(path: Path) -> None:
    table = tomllib.loads(path.read_text(encoding="utf-8"))
    assert table["description"]
    assert table["source"]
    body = mbdlft.load_body(path, "left", modes=2)
    assert body.name == "left"


def test_panel_has_the_matrices_of_its_script() -> None:
    stored = mbdlft.load_matrices(PANEL.with_suffix(".h5"))
    made = solar_panel.elements()
    exact(stored.nodes.dof, made.nodes.dof)
    roundoff(stored.nodes.coordinates, made.nodes.coordinates)
    for a, b in zip(stored[:2], made[:2], strict=True):
        roundoff(abs(a - b).max() / abs(b).max(), 0.0, scale=1.0)
    table = tomllib.loads(PANEL.read_text(encoding="utf-8"))
    assert (table["parent"], table["ports"]["tip"]) == solar_panel.interfaces(made)


def test_panel_has_the_mass_of_its_volume() -> None:
    """Mass, center and inertia of boxes, by hand."""
    fork, panel = solar_panel.PARTS["fork"].density, solar_panel.PARTS["panel"].density
    boxes = [
        (panel, (0.8, 2.8), (-0.6, 0.6)),
        (fork, (0.0, 0.3), (-0.05, 0.05)),
        (fork, (0.3, 0.4), (-0.4, 0.4)),
        (fork, (0.4, 0.8), (0.3, 0.4)),
        (fork, (0.4, 0.8), (-0.4, -0.3)),
    ]
    mass = first = second = 0.0
    for density, x, y in boxes:
        line = density * solar_panel.THICKNESS * (y[1] - y[0])
        mass += line * (x[1] - x[0])
        first += line * (x[1] ** 2 - x[0] ** 2) / 2
        second += line * (x[1] ** 3 - x[0] ** 3) / 3
    second += mass * solar_panel.THICKNESS**2 / 12
    rigid = reduced_body(PANEL, modes=1).rigid
    roundoff(rigid.mass, mass, kappa=10.0)
    roundoff(rigid.center, [first / mass, 0.0, 0.0], kappa=10.0)
    roundoff(rigid.inertia[1, 1], second, kappa=10.0)
    roundoff(rigid.inertia - np.diag(np.diag(rigid.inertia)), np.zeros((3, 3)), scale=1.0)


def satellite(body: mbdlft.FlexibleBody) -> mbdlft.Scene:
    hub = kit.body("hub", "m", (20, 25, 30), ports={"side": (0.5, 0, 0)})
    return kit.scene(
        "satellite",
        mbdlft.Parameter("m", 100.0, percent=20, unit="kg"),
        hub,
        body,
        kit.free("orbit", "ground", "hub", position=(0, 0, 0)),
        kit.weld("root", "hub.side", body.name),
        inputs=["orbit.torque.y"],
        outputs=["orbit.rotation.y"],
    )


def test_scene_with_a_catalogue_body_is_complete_in_itself() -> None:
    """The text that an archive stores has the numbers of the body, not the name of a file."""
    with pytest.warns(mbdlft.MbdlftWarning, match="static-correction"):  # its port carries nothing
        body = mbdlft.load_body(PANEL, "panel", method="effective-mass", modes=4)
    scene = satellite(body)
    model = mbdlft.to_lft(scene, search=0.0)
    assert model.certificate.max_relative_error <= SCENARIO
    assert mbdlft.scene_from_toml(model.provenance.scene) == scene
    # the antiresonance of the hub is a frequency of the clamped panel
    w = body.modes[0].frequency
    near = mbdlft.frequency_response(model, {}, np.array([0.5 * w, w]))[0, :, 0, 0]
    assert abs(near[1]) < 0.05 * abs(near[0])


def test_command_prints_a_table_to_paste() -> None:
    options = ["--name", "left", "--method", "effective-mass", "--modes", "3"]
    result = CliRunner().invoke(app, ["body", str(PANEL), *options])
    assert result.exit_code == 0, result.output
    text = result.output
    expected = mbdlft.load_body(PANEL, "left", method="effective-mass", modes=3)
    assert body_to_toml(expected) in text
    assert text.startswith("# solar_panel.toml: A solar panel")
    assert "% of the rigid mass" in text
    scene = mbdlft.scene_to_toml(satellite(mbdlft.load_body(PANEL, "other")))
    head, _, _ = scene.partition("[bodies.other]")
    tail = scene[scene.index("[joints.orbit]") :].replace('"other"', '"left"')
    pasted = mbdlft.scene_from_toml(head + text + "\n" + tail)
    assert expected in pasted.bodies


def test_command_with_a_body_without_matrices(tmp_path: Path) -> None:
    path = tmp_path / "ball.toml"
    path.write_text(
        'format = "mbdlft-body/1"\ndescription = "A ball."\nsource = "Invented."\n'
        'body = { kind = "point_mass", mass = 2.0 }\n'
    )
    result = CliRunner().invoke(app, ["body", str(path)])
    assert result.exit_code == 0, result.output
    assert result.output.startswith("# ball.toml: A ball.\n# Source: Invented.\n\n[bodies.ball]")
