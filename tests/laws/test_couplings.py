"""Couplings: the truth of maximal coordinates, the limit of stiff ones, steady rates, equilibria."""

from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mbdlft
from mbdlft import Inertia, Parameter, Prismatic, Revolute, RigidBody, Scene, to_lft
from mbdlft.multibody.assembly.coupled import with_positions
from mbdlft.multibody.coupling import KINDS, Coupling
from tests import close
from tests.attack.couplings import attack
from tests.cross.test_mechanism import equals_truth

N = Parameter("n", 5.0, low=3.0, high=8.0)
ROUND = Inertia(xx=0.1, yy=0.1, zz=0.02)


def machine(coupling: Coupling, *more: Coupling, inputs: Any = ("a.torque",), **joints: Any) -> Scene:
    """Rotors a, b and c about z and a slide s along x, each on the ground; a is driven."""
    fields = {"parent": "ground", "axis": (0, 0, 1), "preload": 0.0}
    made = [
        Revolute(name=name, child=f"rotor_{name}", **{**fields, **joints.get(name, {})}) for name in "abc"
    ]
    slide = {**fields, "axis": (1, 0, 0), **joints.get("s", {})}
    return Scene(
        name="machine",
        parameters=[N],
        bodies=[
            *(RigidBody(name=f"rotor_{name}", mass=1.0, inertia=ROUND) for name in "abc"),
            RigidBody(name="sled", mass=3.0),
        ],
        joints=[*made, Prismatic(name="s", child="sled", **slide)],
        couplings=[coupling, *more],
        inputs=inputs,
    )


@pytest.mark.parametrize(
    ("kind", "fields"),
    [
        ("gear", {"joints": ("b", "a"), "ratio": "n"}),
        ("gear", {"joints": ("a", "b"), "ratio": "n", "stiffness": 50.0, "damping": 0.2}),
        ("planetary", {"sun": "a", "ring": "b", "carrier": "c", "ratio": "n"}),
        ("differential", {"left": "a", "right": "b", "carrier": "c"}),
        ("belt", {"joints": ("b", "a"), "radii": (0.2, "0.1*n")}),
        ("belt", {"joints": ("b", "a"), "radii": (0.2, 0.1), "crossed": True}),
        ("rack", {"joint": "a", "slider": "s", "radius": "0.1*n"}),
        ("screw", {"joint": "a", "slider": "s", "pitch": 0.01}),
        ("mimic", {"joint": "s", "leader": "a", "multiplier": "1/n"}),
    ],
    ids=str,
)
def test_couplings_equal_maximal_coordinates(kind: str, fields: dict[str, Any]) -> None:
    equals_truth(machine(KINDS[kind](name="k", **fields), inputs=("a.torque", "b.torque", "c.torque")))


def test_a_stiff_coupling_tends_to_a_rigid_one() -> None:
    gear = {"name": "k", "joints": ("a", "b"), "ratio": "n"}

    def response(**more: Any) -> np.ndarray:
        scene = machine(KINDS["gear"](**gear, **more)).model_copy(update={"outputs": ("b.angle",)})
        v = mbdlft.matrices_at(to_lft(scene, search=0.0), {"n": 4.0})
        return v.C @ np.linalg.solve(300j * np.eye(len(v.A)) - v.A, v.B) + v.D

    rigid = response()
    errors = [
        np.max(np.abs(response(stiffness=k) - rigid)) / np.max(np.abs(rigid)) for k in (1e5, 1e7, 1e9)
    ]
    for error, next_error in pairwise(errors):
        assert 90.0 < error / next_error < 110.0
    assert errors[-1] < 1e-4


def test_force_and_positions_follow_at_equilibrium() -> None:
    """A drum holds a weight by a cable of two strands: torque m g r/2, and so is the trim."""
    cable = KINDS["cable"](name="k", strands={"s": 2.0, "a": 0.1}, offset=0.7)
    scene = machine(cable, a={"position": 1.0, "preload": None}, s={"position": 0.3, "axis": (0, 0, 1)})
    scene = scene.model_copy(update={"gravity": (0.0, 0.0, -10.0)})
    model = to_lft(scene, search=0.0)
    trim = dict(
        zip((s.name for s in model.trim.signals), np.ravel(mbdlft.trim_at(model, {})), strict=True)
    )
    assert np.isclose(trim["k.force"], 15.0)
    assert np.isclose(trim["a.torque"], -1.5)
    point = mbdlft.find_equilibrium(scene, positions=["s"])
    assert point.positions == {"s.position": 0.3}


FOLLOW = [
    ("gear", {"joints": ("a", "b"), "ratio": 2.0, "offset": 0.3}, "th", "0.3 + 2*th", 2.0),
    ("gear", {"joints": ("b", "a"), "ratio": 2.0, "offset": 0.3}, "2*th", "th - 0.15", 0.5),
    (
        "mimic",
        {"joint": "a", "leader": "b", "multiplier": -1.0, "offset": "17*deg"},
        "th",
        "17*pi/180 - th",
        1.0,
    ),
    ("belt", {"joints": ("b", "a"), "radii": (0.2, 0.1), "offset": 0.05}, "th", "2*th - 0.5", 2.0),
    ("gear", {"joints": ("a", "b"), "ratio": 100.0, "offset": 0.2}, "0.5", "50.2", 100.0),
]


@pytest.mark.parametrize(("kind", "fields", "b_of", "a_of", "ratio"), FOLLOW, ids=str)
def test_a_position_follows(
    kind: str, fields: dict[str, Any], b_of: str, a_of: str, ratio: float
) -> None:
    """Of two levers on a coupling, a = r b + offset: m g c (sin b + r^2 sin a) pulls them back."""
    levers = [
        RigidBody(name=f"lever_{name}", mass=1.5, center_of_mass=(0.2, 0, 0), inertia=Inertia(yy=0.1))
        for name in "ab"
    ]
    hinges = [
        Revolute(name=name, parent="ground", child=f"lever_{name}", axis=(0, 1, 0), **given)
        for name, given in (("a", {"preload": 0.0}), ("b", {"position": b_of}))
    ]
    scene = Scene(
        name="levers",
        gravity=(0.0, 0.0, -10.0),
        parameters=[mbdlft.Angle("th", 20.0, low=0.0, high=40.0)],
        bodies=levers,
        joints=hinges,
        couplings=[KINDS[kind](name="k", **fields)],
    )
    model = to_lft(scene, search=0.0)
    for th in (0.0, 20.0, 33.0):
        a, b = (eval(text, {"th": np.radians(th), "pi": np.pi}) for text in (a_of, b_of))
        stiffness, inertia = 3.0 * (np.sin(b) + ratio**2 * np.sin(a)), 0.16 * (1.0 + ratio**2)
        at = mbdlft.matrices_at(model, {"th": th})
        assert np.isclose(np.linalg.det(at.A), stiffness / inertia, rtol=close.CLOSED_FORM)


def test_positions_follow_along_couplings() -> None:
    """b is given, a follows a gear from it, and the slide a rack from that; or all from zero."""
    gear = KINDS["gear"](name="k", joints=("a", "b"), ratio=2.0, offset=0.3)
    rack = KINDS["rack"](name="r", joint="a", slider="s", radius="0.1 [m]*n", offset=0.2)
    for couplings in ((gear, rack), (rack, gear)):
        scene, follows = with_positions(machine(*couplings, b={"position": 0.1}))
        assert follows == {"a": "k", "s": "r"}
        mbdlft.assemble(scene)  # which checks the offsets
    _, follows = with_positions(machine(rack, gear))
    assert follows == {"s": "r", "b": "k"}


def test_coupled_steady_rates_leave_both_angles_out() -> None:
    gear = KINDS["gear"](name="k", joints=("a", "b"), ratio="n")
    rates = {"a": {"rate": "n*10", "preload": None}, "b": {"rate": 10.0}}
    model = to_lft(machine(gear, **rates), search=0.0)
    names = [state.name for state in model.states]
    assert not {"a.angle", "b.angle"} & set(names)
    assert len(names) == 5  # one of two rates, c and s


def test_toml_is_lossless() -> None:
    scene = machine(
        KINDS["cable"](name="k", strands={"s": 2.0, "a": "0.1*n"}, stiffness="n", damping=0.1)
    )
    assert mbdlft.multibody.scene_from_toml(mbdlft.multibody.scene_to_toml(scene)) == scene


@pytest.mark.long
@pytest.mark.parametrize("seed", range(30))
def test_coupled_mechanisms_equal_maximal_coordinates(seed: int, tmp_path: Path) -> None:
    assert attack(seed, tmp_path) in ("right", "refused")


@pytest.mark.parametrize(("stiffness", "spring"), [(None, 0.0), (1e6, 0.0), (1e6, 1e-3)])
def test_what_a_screw_turns_turns_on(stiffness: float | None, spring: float) -> None:
    """100 kg on 5 kN/m turn a screw of 10 mm pitch 19.6 times, against a weak spring or none."""
    law = {} if stiffness is None else {"stiffness": stiffness, "preload": 0.0}
    fields = {"parent": "ground", "axis": (0, 0, 1), "preload": 0.0}
    scene = Scene(
        name="jack",
        gravity=(0, 0, -9.81),
        bodies=[
            mbdlft.PointMass(name="load", mass=100.0),
            RigidBody(name="rotor", mass=1, inertia=ROUND),
        ],
        joints=[
            Prismatic(name="s", child="load", stiffness=5e3, **fields),
            Revolute(name="m", child="rotor", stiffness=spring, **fields),
        ],
        couplings=[KINDS["screw"](name="screw", joint="m", slider="s", pitch=0.01, **law)],
    )
    point, lead, soft = mbdlft.find_equilibrium(scene), 0.01 / (2.0 * np.pi), 1.0 / (stiffness or np.inf)
    equations = [[5e3, 0.0, -1.0], [0.0, spring, lead], [-1.0, lead, -soft]]
    way, angle, force = np.linalg.solve(equations, [-981.0, 0.0, 0.0])
    close.target(point.positions["s.position"], way, close.CLOSED_FORM)
    close.target(point.positions["m.angle"], angle, close.CLOSED_FORM)
    there = mbdlft.at_equilibrium(scene, point)
    if stiffness is not None:
        assert abs(there.couplings[0].preload - force) <= close.CLOSED_FORM * 981.0
    close.target(mbdlft.find_equilibrium(there).positions["s.position"], way, close.CLOSED_FORM)
