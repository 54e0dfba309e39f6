"""Scenes that are hard for floating point: what cancels, wide and tiny ranges, long sums.

What a scene does not depend on must not be counted, however the numbers are rounded.
"""

import pytest

import mbdlft
from tests.close import SCENARIO


def balanced_arm(angle: float) -> mbdlft.Scene:
    """Three links about one axis without gravity, the last one balanced on its joint."""
    inertia = mbdlft.Inertia(xx=0.7)
    bodies = [
        mbdlft.RigidBody(
            name=f"b{k}",
            mass="m" if k == 2 else 1.3,
            center_of_mass=(0, 0 if k == 2 else 0.4, 0),
            inertia=inertia,
            ports={"tip": (0, 0.9, 0)},
        )
        for k in range(3)
    ]
    joints = [
        mbdlft.Revolute(
            name=f"j{k}",
            parent=f"b{k - 1}.tip" if k else "ground",
            child=f"b{k}",
            axis=(1, 0, 0),
            position="t" if k == 2 else 0.3,
        )
        for k in range(3)
    ]
    parameters = [mbdlft.Parameter("m", 2.0, percent=20, unit="kg"), mbdlft.Angle("t", angle, plus=20)]
    return mbdlft.Scene(name="balanced", parameters=parameters, bodies=bodies, joints=joints)


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
    scene = mbdlft.Scene(
        name="screw",
        parameters=[mbdlft.Parameter("d", 0.5, percent=40, unit="m")],
        bodies=[
            mbdlft.RigidBody(name="rotor", mass=1, inertia=mbdlft.Inertia(xx=1, yy=1, zz=1)),
            mbdlft.RigidBody(name="slide", mass=2, inertia=mbdlft.Inertia(xx=1, yy=1, zz=1)),
        ],
        joints=[
            mbdlft.Revolute(name="turn", parent="ground", child="rotor", axis=axis),
            mbdlft.Prismatic(name="push", parent="rotor", child="slide", axis=axis, position="d"),
        ],
    )
    assert mbdlft.to_lft(scene, search=0.0).order == 0


def pendulum(percent: float) -> mbdlft.Scene:
    return mbdlft.Scene(
        name="pendulum",
        gravity=(0, 0, -9.81),
        parameters=[
            mbdlft.Parameter("m", 2.0, percent=percent, unit="kg"),
            mbdlft.Parameter("L", 0.8, percent=percent, unit="m"),
        ],
        bodies=[
            mbdlft.RigidBody(
                name="link", mass=0, inertia=mbdlft.Inertia(xx=0), ports={"tip": (0, 0, "-L")}
            ),
            mbdlft.PointMass(name="bob", mass="m"),
        ],
        joints=[
            mbdlft.Revolute(name="pivot", parent="ground", child="link", axis=(1, 0, 0)),
            mbdlft.Fixed(name="tip", parent="link.tip", child="bob"),
        ],
    )


@pytest.mark.parametrize("percent", [1e-4, 1.0, 99.0, 99.99])
def test_wide_and_narrow_ranges(percent: float) -> None:
    """From a part in a million to a factor of twenty thousand between the ends."""
    model = mbdlft.to_lft(pendulum(percent), search=0.0)
    assert model.order == 3 == sum(model.certificate.lower_bound)
    assert model.certificate.max_relative_error <= SCENARIO


def test_long_sums_do_not_recurse() -> None:
    scene = pendulum(20.0)
    bob = mbdlft.PointMass(name="bob", mass=" + ".join(["0.001*m"] * 1500))
    model = mbdlft.to_lft(scene.model_copy(update={"bodies": (scene.bodies[0], bob)}), search=0.0)
    assert dict(model.lft.blocks) == {"L": 2, "m": 1}


def test_nominal_at_the_end_of_its_range_is_refused() -> None:
    with pytest.raises(mbdlft.SceneError, match="too close to an end of the range"):
        mbdlft.Parameter("x", 0.0, -1e-9, 1e9)
