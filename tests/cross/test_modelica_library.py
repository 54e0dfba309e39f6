"""Mechanisms of the Modelica Standard Library against the same ones as scenes, and closed forms.

The library is no part of the repository: `MODELICA_LIBRARY` names its zip file.
"""

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any
from zipfile import ZipFile

import numpy as np
import pytest

import mbdlft
from mbdlft.modelica import ModelicaTable, operating_point, translate
from mbdlft.modelica.loading import compiled_model
from tests.close import CROSS, target

pytest.importorskip("rumoca", reason="the compiler rumoca is not installed")

LIBRARY = Path(
    os.environ.get("MODELICA_LIBRARY", Path(__file__).parents[3] / "shared" / "modelica-library.zip")
)
PENDULUM = """
format = "mbdlft-scene/1"
name = "pendulum"
gravity = [0.0, -9.80665, 0.0]
[parameters]
m = { nominal = 1.0, percent = 20, unit = "kg" }
[bodies.body]
kind = "rigid"
mass = "m"
center_of_mass = [0.5, 0.0, 0.0]
inertia = { xx = 0.001, yy = 0.001, zz = 0.001 }
[joints.rev]
kind = "revolute"
parent = "ground"
child = "body"
axis = [0, 0, 1]
position = "90 [deg]"
damping = 0.1
[linearize]
inputs = ["rev.torque"]
outputs = ["rev.angle"]
"""


BOX = """
[bodies.{name}]
kind = "rigid"
mass = "m"
center_of_mass = [0.25, 0.0, 0.0]
ports.tip = [0.5, 0.0, 0.0]
inertia = {{ xx = "m*0.0006 [m^2]", yy = "m*0.2536 [m^2]/12", zz = "m*0.2536 [m^2]/12" }}
"""
DOUBLE = f"""
format = "mbdlft-scene/1"
name = "double"
gravity = [0.0, -9.80665, 0.0]
[parameters]
m = {{ nominal = 13.86, percent = 20, unit = "kg" }}
{BOX.format(name="first")}
{BOX.format(name="second")}
[joints.one]
kind = "revolute"
parent = "ground"
child = "first"
axis = [0, 0, 1]
position = "90 [deg]"
damping = 0.1
[joints.two]
kind = "revolute"
parent = "first.tip"
child = "second"
axis = [0, 0, 1]
[linearize]
inputs = ["one.torque"]
outputs = ["one.angle"]
"""


def of_pendulum() -> Any:
    return np.roots([0.001 + 0.5**2, 0.1, -0.5 * 9.80665])  # it stands: J s^2 + d s - m g l


def of_double() -> Any:
    """Poles of two boxes that stand, where Newton's method leads from the start, in angles from there."""
    m, length, g = 13.86, 0.5, 9.80665
    own = m * (length**2 + 0.06**2) / 12 + m * length**2 / 4
    M = np.array([[own + m * length**2, m * length**2 / 2], [m * length**2 / 2, own]])
    K, D = -np.diag([1.5, 0.5]) * m * g * length, np.diag([0.1, 0.0])
    lower = -np.linalg.solve(M, np.hstack([K, D]))
    return np.linalg.eigvals(np.vstack([np.hstack([np.zeros((2, 2)), np.eye(2)]), lower]))


@pytest.mark.long
@pytest.mark.skipif(not LIBRARY.is_file(), reason="the Modelica Standard Library is not there")
@pytest.mark.parametrize(
    ("name", "text", "mass", "poles_of"),
    [("Pendulum", PENDULUM, 1.0, of_pendulum), ("DoublePendulum", DOUBLE, 13.86, of_double)],
)
def test_a_mechanism_of_the_library_has_the_poles_of_the_scene(
    tmp_path: Path, name: str, text: str, mass: float, poles_of: Callable[[], Any]
) -> None:
    with ZipFile(LIBRARY) as library:
        library.extractall(tmp_path)
    example = f"Modelica.Mechanics.MultiBody.Examples.Elementary.{name}"
    file = tmp_path / "one.mo"
    file.write_text(f"model One\n  extends {example};\nend One;\n")
    dae, report = translate(compiled_model(file, "One", [tmp_path]), ModelicaTable())
    of_library = mbdlft.linearize_dae(operating_point(dae, report))
    nominal = {p.name: [p.nominal] for p in dae.parameters}
    scene = tmp_path / "pendulum.toml"
    scene.write_text(text)
    of_scene = mbdlft.to_lft(mbdlft.load_scene(scene))
    for model, point in ((of_library, nominal), (of_scene, {"m": [mass]})):
        A = np.asarray(mbdlft.matrices_at(model, point)[0])
        poles = np.linalg.eigvals(A.reshape(A.shape[-2:]))
        target(np.sort_complex(poles), np.sort_complex(poles_of()), CROSS)
