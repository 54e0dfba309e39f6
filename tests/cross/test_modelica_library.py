"""Mechanisms of the Modelica Standard Library against the same ones as scenes, and closed forms.

The library is no part of the repository: `MODELICA_LIBRARY` names its zip file.
"""

import os
from pathlib import Path
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
position = "-90 [deg]"
damping = 0.1
[linearize]
inputs = ["rev.torque"]
outputs = ["rev.angle"]
"""


@pytest.mark.long
@pytest.mark.skipif(not LIBRARY.is_file(), reason="the Modelica Standard Library is not there")
def test_the_pendulum_of_the_library_has_the_poles_of_the_scene(tmp_path: Path) -> None:
    with ZipFile(LIBRARY) as library:
        library.extractall(tmp_path)
    example = "Modelica.Mechanics.MultiBody.Examples.Elementary.Pendulum"
    file = tmp_path / "one.mo"
    file.write_text(f"model One\n  extends {example};\nend One;\n")
    dae, report = translate(compiled_model(file, "One", [tmp_path]), ModelicaTable())
    of_library = mbdlft.linearize_dae(operating_point(dae, report))
    nominal = {p.name: [p.nominal] for p in dae.parameters}
    scene = tmp_path / "pendulum.toml"
    scene.write_text(PENDULUM)
    of_scene = mbdlft.to_lft(mbdlft.load_scene(scene))
    closed = np.roots([0.001 + 0.5**2, 0.1, 0.5 * 9.80665])  # J s^2 + d s + m g l
    for model, point in ((of_library, nominal), (of_scene, {"m": [1.0]})):
        A = np.asarray(mbdlft.matrices_at(model, point)[0])
        poles = np.linalg.eigvals(A.reshape(A.shape[-2:]))
        target(np.sort_complex(poles), np.sort_complex(closed), CROSS)
