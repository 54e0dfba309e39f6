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
from mbdlft import Inertia, Parameter, RigidBody, Scene
from mbdlft.modelica import ModelicaTable, operating_point, translate
from mbdlft.modelica.loading import compiled_model
from mbdlft.modelica.tree import FlatModel
from tests import kit
from tests.close import CROSS, target

pytest.importorskip("rumoca", reason="the compiler rumoca is not installed")

LIBRARY = Path(
    os.environ.get("MODELICA_LIBRARY", Path(__file__).parents[3] / "shared" / "modelica-library.zip")
)
STANDS = {"gravity": (0.0, -9.80665, 0.0)}


def pendulum() -> Scene:
    return kit.scene(
        "pendulum",
        Parameter("m", 1.0, percent=20, unit="kg"),
        kit.body("body", "m", (0.001, 0.001, 0.001), center_of_mass=(0.5, 0, 0)),
        kit.hinge("rev", "ground", "body", (0, 0, 1), position="90 [deg]", damping=0.1),
        inputs=["rev.torque"],
        outputs=["rev.angle"],
        **STANDS,
    )


def double() -> Scene:
    across, shape = "m*0.2536 [m^2]/12", {"center_of_mass": (0.25, 0, 0), "ports": {"tip": (0.5, 0, 0)}}
    return kit.scene(
        "double",
        Parameter("m", 13.86, percent=20, unit="kg"),
        *(kit.body(x, "m", ("m*0.0006 [m^2]", across, across), **shape) for x in ("first", "second")),
        kit.hinge("one", "ground", "first", (0, 0, 1), position="90 [deg]", damping=0.1),
        kit.hinge("two", "first.tip", "second", (0, 0, 1)),
        inputs=["one.torque"],
        outputs=["one.angle"],
        **STANDS,
    )


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


EXAMPLES = "Modelica.Mechanics.MultiBody.Examples"
LIBRARY_IS_THERE = pytest.mark.skipif(
    not LIBRARY.is_file(), reason="the Modelica Standard Library is not there"
)


def flat_example(tmp_path: Path, example: str, more: str = "") -> FlatModel:
    """An example of the library, with more text, as the compiler flattens it."""
    with ZipFile(LIBRARY) as library:
        library.extractall(tmp_path)
    file = tmp_path / "one.mo"
    file.write_text(f"model One\n  extends {EXAMPLES}.{example};\n{more}\nend One;\n")
    return compiled_model(file, "One", [tmp_path])


@pytest.mark.long
@LIBRARY_IS_THERE
@pytest.mark.parametrize(
    ("name", "scene", "mass", "poles_of"),
    [("Pendulum", pendulum, 1.0, of_pendulum), ("DoublePendulum", double, 13.86, of_double)],
)
def test_a_mechanism_of_the_library_has_the_poles_of_the_scene(
    tmp_path: Path, name: str, scene: Callable[[], Scene], mass: float, poles_of: Callable[[], Any]
) -> None:
    dae, report = translate(flat_example(tmp_path, f"Elementary.{name}"), ModelicaTable())
    of_library = mbdlft.linearize_dae(operating_point(dae, report))
    nominal = {p.name: [p.nominal] for p in dae.parameters}
    of_scene = mbdlft.to_lft(scene())
    for model, point in ((of_library, nominal), (of_scene, {"m": [mass]})):
        A = np.asarray(mbdlft.matrices_at(model, point)[0])
        poles = np.linalg.eigvals(A.reshape(A.shape[-2:]))
        target(np.sort_complex(poles), np.sort_complex(poles_of()), CROSS)


# the same mechanism as a scene, at all values of its parameters ---------------------------------

G = (0, -9.80665, 0)


def springs(parameters: list[Parameter]) -> Scene:
    """Two masses that hang on springs, one at the axis of its joint and one between two frames."""
    return kit.scene(
        "springs",
        *parameters,
        *(kit.point(f"body{k}", f"body{k}_m") for k in (1, 2)),
        *(kit.rail(f"p{k}", "ground", f"body{k}", (0, -1, 0), stiffness=f"spring{k}_c") for k in (1, 2)),
        gravity=G,
        inputs=["p1.force", "p2.force"],
        outputs=["p1.position", "p2.position"],
    )


def bar(name: str, x: float, y: float) -> RigidBody:
    """A box of steel, 5 cm wide, from (0, 0) to (x, y)."""
    length, width = float(np.hypot(x, y)), 0.05
    mass = f"{name}_density*{width**2 * length!r} [m^3]"
    I = f"{mass}*{(length**2 + width**2) / 12!r} [m^2]"  # noqa: E741
    own = Inertia(xx=I, yy=I, zz=I)  # the motion is in the plane
    center = (x / 2, y / 2, 0)
    return kit.body(name, mass, center_of_mass=center, inertia=own, ports={"tip": (x, y, 0)})


def four_bar(parameters: list[Parameter]) -> Scene:
    z = (0, 0, 1)
    return kit.scene(
        "four_bar",
        *parameters,
        *(bar("body1", 0.4, 0.0), bar("body2", 0.1, 1.1), bar("body4", 0.65, 0.1)),
        kit.body("body3", 0, ports={"tip": (-0.15, 1, 0)}),
        kit.weld("weld", "ground", "body3"),
        kit.hinge("r1", "ground", "body1", z, damping="damper_d"),
        kit.hinge("r2", "body1.tip", "body2", z, preload=0),
        kit.hinge("r3", "body3.tip", "body4", z, preload=0),
        kit.loop("cut", "revolute", "body4.tip", "body2.tip", axis=z),
        gravity=G,
        inputs=["r1.torque"],
        outputs=["r1.angle", "r3.angle"],
    )


_ROBOT = (  # axis, mass, center of mass, inertia about it, and where the next body begins
    # I_11 and I_33 of the first body, which only turns about y, are none of a body in the library
    ((0, 1, 0), 1.0, (0, 0, 0), {"xx": 0.6, "yy": 1.16, "zz": 0.6}, (0, 0.324, 0.3)),
    (
        (1, 0, 0),
        "b2_m",
        (0.172, 0.205, 0),
        {"xx": 2.58, "yy": 0.64, "zz": 2.73, "xy": -0.46},
        (0, 0.65, 0),
    ),
    (
        (1, 0, 0),
        "b3_m",
        (0.064, -0.034, 0),
        {"xx": 0.279, "yy": 0.245, "zz": 0.413, "xy": -0.07},
        (0, 0.414, -0.155),
    ),
    ((0, 1, 0), 28.7, (0, 0, 0), {"xx": 1.67, "yy": 0.081, "zz": 1.67}, (0, 0.186, 0)),
    ((1, 0, 0), 5.2, (0, 0, 0), {"xx": 1.25, "yy": 0.81, "zz": 1.53}, (0, 0.125, 0)),
    ((0, 1, 0), 0.5, (0.05, 0.05, 0.05), {"xx": 0.001, "yy": 0.001, "zz": 0.001}, (0, 0, 0)),
)
_POSE = (0.2, 0.3, -0.5, 0.1, 0.4, -0.2)


def robot(parameters: list[Parameter]) -> Scene:
    """The mechanics of the R3, with a load in its hand."""
    bodies = [kit.body("base", 0, ports={"tip": (0, 0.351, 0)})]
    joints: list[Any] = [kit.weld("weld", "ground", "base")]
    for k, (axis, mass, center, inertia, tip) in enumerate(_ROBOT, 1):
        parent = f"{bodies[-1].name}.tip"
        joints.append(kit.hinge(f"r{k}", parent, f"b{k}", axis, position=_POSE[k - 1]))
        own = Inertia(**inertia)
        bodies.append(kit.body(f"b{k}", mass, center_of_mass=center, inertia=own, ports={"tip": tip}))
    own = Inertia(xx=0.001, yy=0.001, zz=0.001)
    bodies.append(kit.body("load", "mLoad", center_of_mass=(0, 0.25, 0), inertia=own))
    return kit.scene(
        "robot",
        *parameters,
        *bodies,
        *joints,
        kit.weld("grip", "b6.tip", "load"),
        gravity=(0, -9.81, 0),
        inputs=[f"r{k}.torque" for k in range(1, 7)],
        outputs=[f"r{k}.angle" for k in range(1, 7)],
    )


SPRINGS = """
  input Real f1; input Real f2;
  Modelica.Mechanics.Translational.Sources.Force drive1, drive2;
equation
  drive1.f = f1; drive2.f = f2;
  connect(drive1.flange, p1.axis); connect(drive2.flange, p2.axis);
"""
FOUR_BAR = """
  input Real torque;
  Modelica.Mechanics.Rotational.Sources.Torque drive;
equation
  drive.tau = torque;
  connect(drive.flange, revolute1.axis);
"""
ROBOT = """
  input Real t1, t2, t3, t4, t5, t6;
  Modelica.Mechanics.Rotational.Sources.Torque m1, m2, m3, m4, m5, m6;
equation
""" + "".join(f"  m{k}.tau = t{k}; connect(m{k}.flange, axis{k});\n" for k in range(1, 7))


@pytest.mark.long
@LIBRARY_IS_THERE
@pytest.mark.parametrize(
    ("example", "more", "parameters", "outputs", "held", "scene"),
    [
        (
            *("Elementary.SpringMassSystem", SPRINGS, "body1.m body2.m spring1.c spring2.c"),
            *("p1.s p2.s", {}, springs),
        ),
        (
            *("Loops.PlanarFourbar", FOUR_BAR, "body1.density body2.density body4.density damper.d"),
            *("revolute1.phi revolute3.phi", {"revolute1.phi": 0.0}, four_bar),
        ),
        (
            *("Systems.RobotR3.Utilities.MechanicalStructure", ROBOT, "mLoad b2.m b3.m"),
            " ".join(f"r{k}.phi" for k in range(1, 7)),
            {f"r{k}.phi": _POSE[k - 1] for k in range(1, 7)},
            robot,
        ),
    ],
)
def test_a_mechanism_of_the_library_is_the_scene_at_all_values_of_its_parameters(
    tmp_path: Path,
    example: str,
    more: str,
    parameters: str,
    outputs: str,
    held: dict[str, float | str],
    scene: Callable[[list[Parameter]], Scene],
) -> None:
    """Parameters have the names of their places in the model, and components get them on."""
    table = ModelicaTable(
        parameters={name: {"percent": 20} for name in parameters.split()},
        outputs=tuple(outputs.split()),
        at=held,
        free={0: (), 1: ("torque",)}.get(len(held), tuple(f"t{k}" for k in range(1, 7))),
    )
    dae, report = translate(flat_example(tmp_path, example, more), table)
    of_library = mbdlft.linearize_dae(operating_point(dae, report, table))
    assert of_library.parameters.names == tuple(sorted(parameters.replace(".", "_").split()))
    of_scene = mbdlft.to_lft(scene(list(dae.parameters)))
    assert of_library.order == of_scene.order == (10 if len(held) > 1 else 4)
    samples = mbdlft.random(of_library.parameters, 4, 3)
    for s in (0.3 + 1j, 1.0 + 2j, 10j):
        target(kit.transfer(of_library, s, samples), kit.transfer(of_scene, s, samples), CROSS)
