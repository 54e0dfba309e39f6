"""Laws of relations that numbers nearly have: they cost repetitions, are said, and change nothing."""

from fractions import Fraction
from pathlib import Path

import pytest

import mbdlft
from mbdlft.exact.numbers import Constant
from mbdlft.pipeline.forms import Signed, neighbors
from tests.close import ELASTIC, exact

INERTIA = mbdlft.Inertia(xx=1.0, yy=2.0, zz=2.5)


def two_axes(axis: tuple[float, ...], tilt: float | str = "30*deg") -> mbdlft.Scene:
    """Two joints with angles as parameters, the second in a frame that is tilted around x."""
    own = {"center_of_mass": (0.1, 0.2, 0.3), "inertia": INERTIA}
    return mbdlft.Scene(
        name="axes",
        gravity=(0, 0, -9.81),
        parameters=[
            mbdlft.Parameter("m", 1, percent=20, unit="kg"),
            mbdlft.Angle("theta", 20, plus=40),
            mbdlft.Angle("phi", 20, plus=40),
        ],
        bodies=[
            mbdlft.RigidBody(name="a", mass=2.0, **own, ports={"tip": (0, 1, 0.2)}),
            mbdlft.RigidBody(name="b", mass="m", **own),
        ],
        joints=[
            mbdlft.Revolute(name="j", parent="ground", child="a", axis=(0, 0, 1), position="theta"),
            mbdlft.Revolute(
                name="k",
                parent="a.tip",
                child="b",
                axis=axis,
                orientation=[mbdlft.Rotation(axis=(1, 0, 0), angle=tilt)],
                position="phi",
            ),
        ],
    )


def certified(scene: mbdlft.Scene) -> mbdlft.Certificate:
    return mbdlft.to_lft(scene, search=0.0).certificate


# 30 deg from the y axis is the z axis of the first frame
EXACT = sum(certified(two_axes((0, 0, 1), 0.0)).order)


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
    assert text.endswith(f"written exactly, the order is {EXACT}, not {model.order}")
    assert model.order > EXACT
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
    scene = mbdlft.Scene(
        name="nearly parallel",
        gravity=(0, 0, -9.81),
        parameters=[
            mbdlft.Parameter("m", 1, percent=20, unit="kg"),
            mbdlft.Parameter("l", 1, percent=20, unit="m"),
            mbdlft.Angle("theta", 20, plus=40),
        ],
        bodies=[
            mbdlft.RigidBody(name="a", mass=2.0, **own, ports={"tip": (0, "l", 0.2)}),
            mbdlft.RigidBody(name="b", mass="m", **own),
        ],
        joints=[
            mbdlft.Revolute(
                name="j", parent="ground", child="a", axis=(1, 0, 0), position="theta", stiffness=1.0
            ),
            mbdlft.Revolute(
                name="k", parent="a.tip", child="b", axis=(1, 0, 1e-12), position="20*deg", stiffness=2.0
            ),
        ],
    )
    assert certified(scene).max_relative_error < ELASTIC


def test_an_angle_in_the_decimals_of_a_double_is_a_right_angle() -> None:
    """1.5707963267948966 rad: a force along the link at 90 deg has no arm, and its torque is zero."""

    def arm(angle: float | str) -> mbdlft.LFTModel:
        none = mbdlft.Inertia(xx=0, yy=0, zz=0)
        scene = mbdlft.Scene(
            name="arm",
            parameters=[mbdlft.Parameter("L", 0.5, percent=20, unit="m")],
            bodies=[
                mbdlft.RigidBody(name="link", mass=0.0, inertia=none, ports={"tip": ("L", 0, 0)}),
                mbdlft.RigidBody(name="hand", mass=2.0, inertia=INERTIA, center_of_mass=(0.2, 0.1, 0)),
            ],
            joints=[
                mbdlft.Revolute(name="a", parent="ground", child="link", axis=(0, 0, 1), position=angle),
                mbdlft.Revolute(name="b", parent="link.tip", child="hand", axis=(0, -1, 0)),
            ],
            loads=[
                mbdlft.Force(name="f", port="hand", direction=(0, 1, 0), frame="ground", magnitude=-5.7)
            ],
        )
        return mbdlft.to_lft(scene, search=0.0, prove=0.0)

    right, decimals = arm("90*deg"), arm(1.5707963267948966)
    assert mbdlft.trim_at(decimals, {"L": 0.55}).tolist() == [0.0, 0.0]
    exact(decimals.lft.M11, right.lft.M11)
    exact(decimals.lft.M22, right.lft.M22)
