"""A planar mechanism costs what a planar one does, also in a plane that is not a coordinate plane."""

from fractions import Fraction
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mbdlft
from benchmarks.needs import TURNED, instructions, thick, turned
from mbdlft.exact.numbers import Constant
from mbdlft.multibody.assembly import resolved
from mbdlft.pipeline.forms import Signed, neighbors
from scenarios import two_link_arm
from tests import kit
from tests.close import ELASTIC, SCENARIO, error, exact, roundoff

SKEW = (TURNED, np.linalg.qr(np.array([[1.0, 2.0, -1.0], [0.5, -1.0, 3.0], [2.0, 0.3, 0.7]]))[0])


def rich() -> mbdlft.Scene:
    """A cart on an inclined rail with a pendulum: springs, forces, buoyancy, orientation, sensors."""
    normal, along = (SKEW[0][:, k] for k in range(2))
    across = np.cross(normal, along)
    sensors = [
        mbdlft.Position(name="tip", port="link.tip"),
        mbdlft.Position(name="seen", port="link.tip", frame="cart"),
        mbdlft.Accelerometer(name="accelerometer", port="link.tip"),
        mbdlft.Gyro(name="gyro", port="link"),
        mbdlft.Momentum(name="momentum"),
        mbdlft.CenterOfMass(name="center"),
        mbdlft.JointWrench(name="load", joint="pivot"),
    ]
    return kit.scene(
        "rich",
        mbdlft.Parameter("m", 2.0, percent=30, unit="kg"),
        mbdlft.Parameter("L", 0.8, percent=20, unit="m"),
        mbdlft.Parameter("a", 0.3, percent=20, unit="m/s^2"),
        mbdlft.Angle("t", 20.0, 0.0, 50.0),
        mbdlft.Ground(ports={"wall": (1.0, 2.0, "L")}),
        kit.point("cart", "m"),
        kit.body(
            "link",
            1.5,
            (0.2, 0.3, "0.1*m*area"),
            xy=0.01,
            xz=0.0,
            yz=-0.02,
            center_of_mass=("0.3*L", 0.1, "0.2*L + 0.05"),
            ports={"tip": tuple(f"{x!r}*L" for x in (along + 0.2 * across).tolist())},
        ),
        kit.rail("rail", "ground", "cart", tuple(along)),
        kit.hinge(
            "pivot",
            "cart",
            "link",
            tuple(-normal),
            position="t",
            damping=0.1,
            orientation=[kit.turn(tuple(normal), 0.4)],
        ),
        kit.spring("spring", "ground.wall", "link.tip", stiffness=20.0, damping=1.0, force_density=3.0),
        kit.force("thrust", "link.tip", tuple(across), magnitude=2.0),
        kit.force("pull", "link", (1, 2, 3), frame="ground", magnitude=1.0),
        kit.torque("motor", "link", tuple(normal), magnitude="0.2*m*circle"),
        mbdlft.Buoyancy(name="lift", port="link.tip", displaced_mass="0.1*m"),
        *sensors,
        gravity=(0.5, -1.0, -9.0),
        acceleration=(0.1, "a", 0.0),
        constants={
            "area": mbdlft.Constant(value=1.0, unit="m^2"),
            "circle": mbdlft.Constant(value=1.0, unit="m^2/s^2"),
        },
    )


@pytest.mark.parametrize("Q", SKEW)
def test_skew_plane_costs_planar_work(Q: np.ndarray) -> None:
    scene = two_link_arm.scene()
    in_space = {"thick": thick(scene), "skew": turned(scene, Q)}
    assert instructions(in_space["thick"]) == instructions(scene)
    assert instructions(in_space["skew"]) <= 1.1 * instructions(scene)
    assert instructions(scene) <= 170  # what is zero is never built
    planar = mbdlft.to_lft(scene, search=0.0)
    assert sum(planar.certificate.raw_order) <= 46
    values = mbdlft.random(planar.parameters, 20)
    for described in in_space.values():
        model = mbdlft.to_lft(described, search=0.0)
        assert model.lft.blocks == planar.lft.blocks
        assert model.certificate.raw_order == planar.certificate.raw_order
        for found, expected in zip(
            mbdlft.matrices_at(model, values), mbdlft.matrices_at(planar, values), strict=True
        ):
            roundoff(found, expected)


def test_rotations_about_skew_axes_meet_two_components() -> None:
    """As many channels as about a coordinate axis, where the bodies are balls about the axes."""

    def spun(axis: tuple[float, float, float]) -> int:
        scene = kit.scene(
            "ball",
            mbdlft.Angle("t", 20.0, 0.0, 60.0),
            kit.point("a", 1.0, ports={"p": (0.1, 0.2, 0.3)}),
            kit.body("b", 1.0, (1, 1, 1)),
            kit.planar("base", "ground", "a", (0.0, 0.0, 1.0)),
            kit.hinge("pivot", "a.p", "b", axis, position="t", damping=0.1),
            gravity=(0.0, 0.0, 0.0),
        )
        return sum(mbdlft.to_lft(scene, search=0.0).certificate.raw_order)

    assert spun((1.0, 2.0, -2.0)) <= spun((1.0, 0.0, 0.0)) + 2


def without_plane(monkeypatch: pytest.MonkeyPatch, scene: mbdlft.Scene) -> mbdlft.LFTModel:
    with monkeypatch.context() as patch:
        patch.setattr(resolved, "_common_axis", lambda *_: None)
        return mbdlft.to_lft(scene, search=0.0)


def difference(a: mbdlft.LFTModel, b: mbdlft.LFTModel) -> float:
    """Largest difference of A, B, C, D relative to each of them, and of the trim."""
    assert (a.states, a.inputs, a.outputs) == (b.states, b.inputs, b.outputs)
    values = mbdlft.random(a.parameters, 10)
    pairs = zip(mbdlft.matrices_at(a, values), mbdlft.matrices_at(b, values), strict=True)
    trims = error(np.array(a.trim.nominal), np.array(b.trim.nominal))
    return max(trims, *(error(found, expected) for found, expected in pairs))


def test_axes_along_the_plane_change_no_value(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = rich()
    expected, found = without_plane(monkeypatch, scene), mbdlft.to_lft(scene, search=0.0)
    roundoff(difference(found, expected), 0.0, kappa=10.0)
    assert sum(found.certificate.raw_order) < sum(expected.certificate.raw_order)


def test_an_axis_that_is_a_little_off_is_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing is taken for planar that is not: a part of 1e-9 off the plane stays."""
    scene = turned(two_link_arm.scene(), SKEW[0])
    off = np.array(scene.joints[1].axis) + np.array([1e-9, 0.0, 0.0])
    joints = (scene.joints[0], scene.joints[1].model_copy(update={"axis": tuple(off)}))
    scene = scene.model_copy(update={"joints": (*joints, *scene.joints[2:])})
    called: list[Any] = []
    right = resolved._axes
    monkeypatch.setattr(resolved, "_axes", lambda *given: called.append(given) or right(*given))
    mbdlft.assemble(scene)
    assert not called
    mbdlft.assemble(turned(two_link_arm.scene(), SKEW[0]))
    assert called


# Laws of relations that numbers nearly have: they cost repetitions, are said, and change nothing.

INERTIA = mbdlft.Inertia(xx=1.0, yy=2.0, zz=2.5)


def two_axes(axis: tuple[float, ...], tilt: float | str = "30*deg") -> mbdlft.Scene:
    """Two joints with angles as parameters, the second in a frame that is tilted around x."""
    own = {"center_of_mass": (0.1, 0.2, 0.3), "inertia": INERTIA}
    return kit.scene(
        "axes",
        mbdlft.Parameter("m", 1, percent=20, unit="kg"),
        mbdlft.Angle("theta", 20, plus=40),
        mbdlft.Angle("phi", 20, plus=40),
        kit.body("a", 2.0, **own, ports={"tip": (0, 1, 0.2)}),
        kit.body("b", "m", **own),
        kit.hinge("j", "ground", "a", (0, 0, 1), position="theta"),
        kit.hinge("k", "a.tip", "b", axis, orientation=[kit.turn((1, 0, 0), tilt)], position="phi"),
        gravity=(0, 0, -9.81),
    )


def certified(scene: mbdlft.Scene) -> mbdlft.Certificate:
    return mbdlft.to_lft(scene, search=0.0).certificate


@cache
def least() -> int:
    """The order of what is meant: 30 deg from the y axis is the z axis of the first frame."""
    return sum(certified(two_axes((0, 0, 1), 0.0)).order)


@pytest.mark.parametrize(
    ("axis", "tilt", "said"),
    [
        ((0, 0.5, 3**0.5 / 2), "30*deg", "0.8660254037844385 is 1e-16 from sqrt(3/4)"),
        ((0, 0.5, 0.866025), "30*deg", "0.8660253028382761 is 1e-07 from sqrt(3/4)"),
        ((0, 0.5, 3**0.5 / 2), 0.5236, "cos(0.5236 rad) is 6e-07 from cos(30 deg)"),
        ((0, -0.5, 3**0.5 / 2), "-30*deg", "0.8660254037844385 is 1e-16 from sqrt(3/4)"),
        ((1e-12, 0, 1), 0.0, "1e-12 is 1e-12 from 0"),
    ],
)
def test_they_cost_repetitions_and_are_said(axis, tilt, said, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    model = mbdlft.to_lft(two_axes(axis, tilt), search=0.0)
    (text,) = model.certificate.near
    assert said in text
    assert text.endswith(f"written exactly, the order is {least()}, not {model.order}")
    assert model.order > least()
    mbdlft.save(tmp_path / "a.h5", model)
    assert mbdlft.load(tmp_path / "a.h5").certificate == model.certificate


def test_what_is_written_exactly_or_far_is_not() -> None:
    for axis, tilt in (((0, 0, 1), 0.0), ((0, 3, 4), "30*deg"), ((0, 0.5, 0.866), 0.52)):
        assert certified(two_axes(axis, tilt)).near == ()
    scene = two_axes((0, 0, 1), 0.0)
    first, second = scene.joints
    for stiffness in (6.28318531, 0.333333):  # nothing is smaller with 2 pi, or with 1/3
        spring = second.model_copy(update={"stiffness": stiffness})
        assert certified(scene.model_copy(update={"joints": (first, spring)})).near == ()


def meant(*numbers: Constant) -> dict[str, str]:
    return {str(Signed(1, a)): str(b) for a, b in neighbors(numbers).items()}


def test_neighbors() -> None:
    def rational(text: str) -> Constant:
        return Constant("rational", Fraction(text))

    assert meant(rational("0.333333")) == {"0.333333": "1/3"}
    assert meant(rational("-1.414214")) == {"-1.414214": "-sqrt(2)"}
    half = Constant("pi", Fraction(1, 2))
    assert meant(half, rational("6.28318531")) == {"6.28318531": "2 pi"}
    assert meant(rational("6.28318531")) == {}  # nothing else has pi
    # as they are written, or not near enough
    for text in ("0.33333", "0.25", "70000000000", "0.333334", "1e-12", "1000.0000001"):
        assert meant(rational(text)) == {}
    axis = (Fraction(0), Fraction(1), Fraction("1.0000001"))
    y, z = (Constant("unit", Fraction(k), direction=axis) for k in (1, 2))
    assert set(meant(y, z).values()) == {"sqrt(1/2)"}
    cosine = Constant("cosine", Fraction("1.0472"), in_radians=True)
    assert meant(cosine) == {"cos(1.0472 rad)": "cos(60 deg)"}
    assert meant(cosine._replace(argument=Fraction("1.05"))) == {}


def test_what_nearly_vanishes_needs_more_bits_and_no_traceback() -> None:
    """Loops that an angle of 1e-12 rad divides by are singular in doubles, and in balls of 384 bits."""
    own = {"center_of_mass": (0.1, 0.2, 0.3), "inertia": INERTIA}
    scene = kit.scene(
        "nearly parallel",
        mbdlft.Parameter("m", 1, percent=20, unit="kg"),
        mbdlft.Parameter("l", 1, percent=20, unit="m"),
        mbdlft.Angle("theta", 20, plus=40),
        kit.body("a", 2.0, **own, ports={"tip": (0, "l", 0.2)}),
        kit.body("b", "m", **own),
        kit.hinge("j", "ground", "a", (1, 0, 0), position="theta", stiffness=1.0),
        kit.hinge("k", "a.tip", "b", (1, 0, 1e-12), position="20*deg", stiffness=2.0),
        gravity=(0, 0, -9.81),
    )
    assert certified(scene).max_relative_error < ELASTIC


def test_an_angle_in_the_decimals_of_a_double_is_a_right_angle() -> None:
    """1.5707963267948966 rad: a force along the link at 90 deg has no arm, and its torque is zero."""

    def arm(angle: float | str) -> mbdlft.LFTModel:
        none = mbdlft.Inertia(xx=0, yy=0, zz=0)
        scene = kit.scene(
            "arm",
            mbdlft.Parameter("L", 0.5, percent=20, unit="m"),
            kit.body("link", 0.0, inertia=none, ports={"tip": ("L", 0, 0)}),
            kit.body("hand", 2.0, inertia=INERTIA, center_of_mass=(0.2, 0.1, 0)),
            kit.hinge("a", "ground", "link", (0, 0, 1), position=angle),
            kit.hinge("b", "link.tip", "hand", (0, -1, 0)),
            kit.force("f", "hand", (0, 1, 0), frame="ground", magnitude=-5.7),
        )
        return mbdlft.to_lft(scene, search=0.0, prove=0.0)

    right, decimals = arm("90*deg"), arm(1.5707963267948966)
    assert mbdlft.trim_at(decimals, {"L": 0.55}).tolist() == [0.0, 0.0]
    exact(decimals.lft.M11, right.lft.M11)
    exact(decimals.lft.M22, right.lft.M22)


# Scenes that are hard for floating point: what cancels, wide and tiny ranges, long sums.
# What a scene does not depend on must not be counted, however the numbers are rounded.


def balanced_arm(angle: float) -> mbdlft.Scene:
    """Three links about one axis without gravity, the last one balanced on its joint."""
    inertia = mbdlft.Inertia(xx=0.7)
    bodies = [
        kit.body(
            f"b{k}",
            "m" if k == 2 else 1.3,
            center_of_mass=(0, 0 if k == 2 else 0.4, 0),
            inertia=inertia,
            ports={"tip": (0, 0.9, 0)},
        )
        for k in range(3)
    ]
    joints = [
        kit.hinge(
            f"j{k}",
            f"b{k - 1}.tip" if k else "ground",
            f"b{k}",
            (1, 0, 0),
            position="t" if k == 2 else 0.3,
        )
        for k in range(3)
    ]
    parameters = [mbdlft.Parameter("m", 2.0, percent=20, unit="kg"), mbdlft.Angle("t", angle, plus=20)]
    return kit.scene("balanced", *parameters, *bodies, *joints)


@pytest.mark.parametrize("angle", [0.0, 20.0, 37.0])
def test_an_angle_that_does_not_matter_has_bound_zero(angle: float) -> None:
    model = mbdlft.to_lft(balanced_arm(angle), search=0.0)
    bound = dict(zip(["m", "t"], model.certificate.lower_bound, strict=True))
    assert bound["t"] == 0
    assert bound["m"] == 2  # it loads both joints inboard
    assert model.certificate.max_relative_error <= SCENARIO


@pytest.mark.parametrize("axis", [(1, 0, 0), (3, 4, 0), (1, 2, 2), (0.3, -0.7, 0.2)])
def test_a_slide_along_the_axis_of_rotation_changes_nothing(axis: tuple[float, ...]) -> None:
    """The position of a slide along the axis of a revolute joint is not felt, whatever the axis."""
    scene = kit.scene(
        "screw",
        mbdlft.Parameter("d", 0.5, percent=40, unit="m"),
        kit.body("rotor", 1, (1, 1, 1)),
        kit.body("slide", 2, (1, 1, 1)),
        kit.hinge("turn", "ground", "rotor", axis),
        kit.rail("push", "rotor", "slide", axis, position="d"),
    )
    assert mbdlft.to_lft(scene, search=0.0).order == 0


def pendulum(percent: float) -> mbdlft.Scene:
    return kit.scene(
        "pendulum",
        mbdlft.Parameter("m", 2.0, percent=percent, unit="kg"),
        mbdlft.Parameter("L", 0.8, percent=percent, unit="m"),
        kit.body("link", 0, xx=0, ports={"tip": (0, 0, "-L")}),
        kit.point("bob", "m"),
        kit.hinge("pivot", "ground", "link", (1, 0, 0)),
        kit.weld("tip", "link.tip", "bob"),
        gravity=(0, 0, -9.81),
    )


@pytest.mark.parametrize("percent", [1e-4, 1.0, 99.0, 99.99])
def test_wide_and_narrow_ranges(percent: float) -> None:
    """From a part in a million to a factor of twenty thousand between the ends."""
    model = mbdlft.to_lft(pendulum(percent), search=0.0)
    assert model.order == 3 == sum(model.certificate.lower_bound)
    assert model.certificate.max_relative_error <= SCENARIO


def test_long_sums_do_not_recurse() -> None:
    scene = pendulum(20.0)
    bob = kit.point("bob", " + ".join(["0.001*m"] * 1500))
    model = mbdlft.to_lft(scene.model_copy(update={"bodies": (scene.bodies[0], bob)}), search=0.0)
    assert dict(model.lft.blocks) == {"L": 2, "m": 1}


def test_nominal_at_the_end_of_its_range_is_refused() -> None:
    with pytest.raises(mbdlft.SceneError, match="too close to an end of the range"):
        mbdlft.Parameter("x", 0.0, -1e-9, 1e9)
