"""Couplings: the truth of maximal coordinates, the limit of stiff ones, steady rates, equilibria."""

from itertools import pairwise
from typing import Any

import numpy as np
import pytest

import mbdlft
from mbdlft import Angle, Ground, Inertia, Parameter, Scene, Strut, to_lft
from mbdlft.multibody import at_equilibrium, find_equilibrium, fit_positions
from mbdlft.multibody.assembly.coupled import with_positions
from mbdlft.multibody.coupling import KINDS, Coupling
from tests import close, kit
from tests.close import CLOSED_FORM, FITTED, MECHANISM, target
from tests.cross.test_mechanism import equals_truth
from tests.errors.table import says

N = Parameter("n", 5.0, low=3.0, high=8.0)
ROUND = Inertia(xx=0.1, yy=0.1, zz=0.02)


def machine(coupling: Coupling, *more: Coupling, inputs: Any = ("a.torque",), **joints: Any) -> Scene:
    """Rotors a, b and c about z and a slide s along x, each on the ground; a is driven."""
    fields = {"parent": "ground", "axis": (0, 0, 1), "preload": 0.0}
    made = [
        kit.hinge(name, child=f"rotor_{name}", **{**fields, **joints.get(name, {})}) for name in "abc"
    ]
    slide = {**fields, "axis": (1, 0, 0), **joints.get("s", {})}
    return kit.scene(
        "machine",
        N,
        *(kit.body(f"rotor_{name}", 1.0, inertia=ROUND) for name in "abc"),
        kit.body("sled", 3.0),
        *made,
        kit.rail("s", child="sled", **slide),
        coupling,
        *more,
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
        return kit.transfer(to_lft(scene, search=0.0), 300j, {"n": 4.0})

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
    levers = [kit.body(f"lever_{name}", 1.5, yy=0.1, center_of_mass=(0.2, 0, 0)) for name in "ab"]
    hinges = [
        kit.hinge(name, "ground", f"lever_{name}", (0, 1, 0), **given)
        for name, given in (("a", {"preload": 0.0}), ("b", {"position": b_of}))
    ]
    scene = kit.scene(
        "levers",
        mbdlft.Angle("th", 20.0, low=0.0, high=40.0),
        *levers,
        *hinges,
        KINDS[kind](name="k", **fields),
        gravity=(0.0, 0.0, -10.0),
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


@pytest.mark.parametrize(("stiffness", "spring"), [(None, 0.0), (1e6, 0.0), (1e6, 1e-3)])
def test_what_a_screw_turns_turns_on(stiffness: float | None, spring: float) -> None:
    """100 kg on 5 kN/m turn a screw of 10 mm pitch 19.6 times, against a weak spring or none."""
    law = {} if stiffness is None else {"stiffness": stiffness, "preload": 0.0}
    fields = {"parent": "ground", "axis": (0, 0, 1), "preload": 0.0}
    scene = kit.scene(
        "jack",
        kit.point("load", 100.0),
        kit.body("rotor", 1, inertia=ROUND),
        kit.rail("s", child="load", stiffness=5e3, **fields),
        kit.hinge("m", child="rotor", stiffness=spring, **fields),
        KINDS["screw"](name="screw", joint="m", slider="s", pitch=0.01, **law),
        gravity=(0, 0, -9.81),
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


# Geared joints and the solar array drive.

RATIO = mbdlft.Parameter("n", 60.0, low=40.0, high=90.0)
J = mbdlft.Parameter("J", 2e-4, percent=40, unit="kg m^2")
K = mbdlft.Parameter("k", 900.0, percent=30, unit="N m/rad")


def wheel(name: str, inertia: float) -> mbdlft.RigidBody:
    return kit.body(name, 2.0, (5.0, 5.0, inertia))


def spacecraft() -> mbdlft.Scene:
    """A hub on a free axis, and an array that a drive turns about the same axis."""
    drive = mbdlft.array_drive(
        "drive",
        "hub",
        "array",
        (0, 0, 1),
        rotor_inertia="J",
        gear_ratio="n",
        stiffness="k",
        damping=0.4,
        friction=0.2,
    )
    return kit.scene(
        "spacecraft",
        RATIO,
        J,
        K,
        wheel("hub", 7.0),
        wheel("array", 3.0),
        drive.body,
        kit.hinge("spin", "ground", "hub", (0, 0, 1)),
        drive.motor,
        drive.shaft,
        inputs=["spin.torque", "drive.torque"],
        outputs=["spin.angle", "drive.angle", "drive_shaft.angle"],
    )


def test_drive_equals_maximal_coordinates() -> None:
    scene = spacecraft()
    assert [joint.damping for joint in scene.joints] == [0.0, 0.2, 0.4]  # motor and shaft
    equals_truth(scene)


def test_without_a_gear_nothing_changes() -> None:
    """A ratio of 1 is the actuator that turns with the child."""
    one = kit.hinge("a", "ground", "b", (0, 0, 1), actuator_inertia=0.3)
    geared = one.model_copy(update={"gear_ratio": 1.0})
    body = wheel("b", 2.0)
    for joint in (one, geared):
        model = mbdlft.to_lft(kit.scene("s", body, joint))
        target(model.B_u[1, 0], 1.0 / 2.3, CLOSED_FORM)
    assert mbdlft.assemble(kit.scene("s", body, one)).degrees_of_freedom == 1
    model = mbdlft.to_lft(kit.scene("s", body, one.model_copy(update={"gear_ratio": 10.0})))
    target(model.B_u[1, 0], 1.0 / (2.0 + 100.0 * 0.3), CLOSED_FORM)


# A strut: its law, its equilibria, and what turns its direction.

_G = 9.81


def hanging(**strut: object) -> Scene:
    """A mass m that slides along z on a strut that stands 0.3 m beside it."""
    return kit.scene(
        "hanging",
        mbdlft.Parameter("m", 2.0, low=1.0, high=3.0, unit="kg"),
        mbdlft.Parameter("k", 500.0, low=400.0, high=800.0, unit="N/m"),
        kit.point("b", "m"),
        Ground(ports={"foot": (0.3, 0, -1)}),
        kit.rail("z", "ground", "b", (0, 0, 1), preload=0),
        kit.strut("s", "ground.foot", "b", (0, 0, 2), stiffness="k", damping=7.0, **strut),
        gravity=(0, 0, -_G),
    )


def test_a_strut_is_a_spring_along_its_direction() -> None:
    model = mbdlft.to_lft(hanging(), search=0.0)
    target(mbdlft.trim_at(model, {"m": 1.5}), [1.5 * _G], CLOSED_FORM)
    found = model.at(m=1.5, k=600.0)
    target(found.A[1], [-600.0 / 1.5, -7.0 / 1.5], CLOSED_FORM)
    target(found.B[1], [1.0 / 1.5, 1.0 / 1.5], CLOSED_FORM)  # the joint and the strut


def test_equilibria_on_a_strut() -> None:
    """It is relaxed at the declared position, so the mass sinks by m g/k; the force is written there."""
    scene = hanging(force=0.0)
    point = find_equilibrium(scene)
    target(point.positions["z.position"], -2.0 * _G / 500.0, MECHANISM)
    written = at_equilibrium(scene, point)
    strut = written.loads[0]
    assert isinstance(strut, Strut)
    assert isinstance(strut.force, str)
    assert strut.force.startswith("(0.0) - (k)*(-0.03")
    fitted = fit_positions(scene, ["z"], tolerance=1e-4)
    model = mbdlft.to_lft(fitted, search=0.0)
    for m, k in ((1.0, 800.0), (3.0, 400.0)):  # the force is the weight wherever the mass sinks to
        found = model.at(m=m, k=k)
        target(found.A[1], [-k / m, -7.0 / m], CLOSED_FORM)
    assert fitted.fit is not None
    assert 0.0 < fitted.fit.bounds["z.position"] <= 1e-4
    assert fitted.fit.bounds["s.force"] <= 800.0 * 1e-4


def test_a_fit_of_a_lever_on_a_strut() -> None:
    """sin q m g l = cos q k (sin q - sin q0): the stiffness there follows by hand."""
    lever = kit.body("l", "m", yy=0.1, center_of_mass=(0, 0, 0.5), ports={"t": (0, 0, 1)})
    strut = kit.strut("s", "ground.w", "l.t", (1, 0, 0), stiffness=100.0, force=0.0)
    scene = kit.scene(
        "lever",
        mbdlft.Parameter("m", 2.0, percent=20, unit="kg"),
        lever,
        Ground(ports={"w": (-1, 0, 1)}),
        kit.hinge("h", "ground", "l", (0, 1, 0), position=0.3, preload=0),
        strut,
        gravity=(0, 0, -_G),
    )
    model = mbdlft.to_lft(fit_positions(scene, ["h"], tolerance=1e-7), search=0.0)
    for m in (1.6, 2.0, 2.4):
        point = find_equilibrium(scene, {"m": m})
        q = point.positions["h.angle"]
        moment = m * _G * 0.5 * np.sin(q) - 100 * np.cos(q) * (np.sin(q) - np.sin(0.3))
        assert abs(moment) < MECHANISM
        slope = m * _G * 0.5 * np.cos(q) + 100 * np.sin(q) * (np.sin(q) - np.sin(0.3))
        slope -= 100 * np.cos(q) ** 2
        target(model.at(m=m).A[1, 0], slope / (0.1 + m * 0.25), FITTED)


def test_a_strut_on_what_spins() -> None:
    """Its direction turns with its parent: only a parent that does not spin may carry it."""

    def scene(parent: str, child: str) -> Scene:
        return kit.scene(
            "spins",
            kit.point("slide", 1.0),
            kit.body("disc", 2.0, (1, 1, 2), ports={"top": (0, 0, 0.1)}),
            Ground(ports={"wall": (1, 0, 0.1)}),
            kit.rail("x", "ground", "slide", (1, 0, 0)),
            kit.hinge("r", "slide", "disc", (0, 0, 1), rate=30.0),
            kit.strut("s", parent, child, (1, 0, 0), stiffness=9, force=0),
            inputs=["x.force"],
        )

    model = mbdlft.to_lft(scene("ground.wall", "disc.top"), search=0.0)
    target(model.at().A[1, 0], -9.0 / 3.0, CLOSED_FORM)
    with says(mbdlft.SceneError, "in a direction that turns with the body"):
        mbdlft.to_lft(scene("disc.top", "ground.wall"), search=0.0)


# Laws of angles 2*atan(r): they are the angle, as an angle parameter is, and exactly.


def arm(position: float | str, parameters: list[Parameter], orientation: float | str = 0.0) -> Scene:
    """A link with a mass at its tip, on a tilted hinge."""
    return kit.scene(
        "arm",
        Parameter("m", 2.0, percent=30, unit="kg"),
        *parameters,
        kit.body(
            "link", 1.0, (0.2, 0.3, 0.4), center_of_mass=(0.1, 0.4, 0), ports={"tip": (0, 0.8, 0.1)}
        ),
        kit.point("tip", "m"),
        kit.hinge(
            "hinge",
            "ground",
            "link",
            (1, 0.2, 0),
            orientation=[kit.turn((0, 0, 1), orientation)],
            position=position,
        ),
        kit.weld("weld", "link.tip", "tip"),
        gravity=(0, 0, -9.81),
    )


TANGENT = Parameter("t", 0.1, low=-0.6, high=0.7)


@pytest.mark.parametrize(
    ("position", "orientation"),
    [
        ("2*atan(t)", 0.0),
        ("-2*atan(t) + 30*deg", 0.0),
        ("4*atan(t)", 0.0),
        ("atan(t) + atan(t)", 0.0),
        ("2*atan(t) - 2*atan(0.5*t^2) + atan(0.3)", 0.0),
        ("2*atan((0.2 + t)/(1.5 - t*0.4))", 0.0),
        (0.3, "2*atan(t)"),
    ],
)
def test_models_equal_maximal_coordinates(position: float | str, orientation: float | str) -> None:
    assert equals_truth(arm(position, [TANGENT], orientation)).certificate.exact


def test_it_costs_as_much_as_an_angle() -> None:
    """2*atan(t) has the repetitions of an angle parameter with the half-angle substitution."""
    angle = Angle("t", 10.0, low=-60.0, high=70.0)
    written = mbdlft.to_lft(arm("2*atan(t)", [TANGENT]), search=0.0)
    declared = mbdlft.to_lft(arm("t", [angle]), search=0.0)
    assert dict(written.lft.blocks) == dict(declared.lft.blocks)
