"""A strut: its law, its equilibria, and what turns its direction."""

import numpy as np

import mbdlft
from mbdlft import Ground, PointMass, Prismatic, RigidBody, Scene, Strut
from mbdlft.multibody import Inertia, Revolute, at_equilibrium, find_equilibrium, fit_positions
from tests.close import CLOSED_FORM, FITTED, MECHANISM, target
from tests.errors.table import says

_G = 9.81


def hanging(**strut: object) -> Scene:
    """A mass m that slides along z on a strut that stands 0.3 m beside it."""
    return Scene(
        name="hanging",
        gravity=(0, 0, -_G),
        parameters=[
            mbdlft.Parameter("m", 2.0, low=1.0, high=3.0, unit="kg"),
            mbdlft.Parameter("k", 500.0, low=400.0, high=800.0, unit="N/m"),
        ],
        bodies=[PointMass(name="b", mass="m"), Ground(ports={"foot": (0.3, 0, -1)})],
        joints=[Prismatic(name="z", parent="ground", child="b", axis=(0, 0, 1), preload=0)],
        loads=[
            Strut(
                name="s",
                parent="ground.foot",
                child="b",
                direction=(0, 0, 2),
                stiffness="k",
                damping=7.0,
                **strut,  # type: ignore[arg-type]
            )
        ],
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
    lever = RigidBody(
        name="l", mass="m", center_of_mass=(0, 0, 0.5), inertia=Inertia(yy=0.1), ports={"t": (0, 0, 1)}
    )
    strut = Strut(
        name="s", parent="ground.w", child="l.t", direction=(1, 0, 0), stiffness=100.0, force=0.0
    )
    scene = Scene(
        name="lever",
        gravity=(0, 0, -_G),
        parameters=[mbdlft.Parameter("m", 2.0, percent=20, unit="kg")],
        bodies=[lever, Ground(ports={"w": (-1, 0, 1)})],
        joints=[Revolute(name="h", parent="ground", child="l", axis=(0, 1, 0), position=0.3, preload=0)],
        loads=[strut],
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
        return Scene(
            name="spins",
            bodies=[
                PointMass(name="slide", mass=1.0),
                RigidBody(
                    name="disc", mass=2.0, inertia=Inertia(xx=1, yy=1, zz=2), ports={"top": (0, 0, 0.1)}
                ),
                Ground(ports={"wall": (1, 0, 0.1)}),
            ],
            joints=[
                Prismatic(name="x", parent="ground", child="slide", axis=(1, 0, 0)),
                Revolute(name="r", parent="slide", child="disc", axis=(0, 0, 1), rate=30.0),
            ],
            loads=[
                Strut(name="s", parent=parent, child=child, direction=(1, 0, 0), stiffness=9, force=0)
            ],
            inputs=["x.force"],
        )

    model = mbdlft.to_lft(scene("ground.wall", "disc.top"), search=0.0)
    target(model.at().A[1, 0], -9.0 / 3.0, CLOSED_FORM)
    with says(mbdlft.SceneError, "in a direction that turns with the body"):
        mbdlft.to_lft(scene("disc.top", "ground.wall"), search=0.0)


def test_direction_of_a_strut_has_a_length() -> None:
    with says(mbdlft.SceneError, "direction has zero length"):
        Strut(name="s", parent="a", child="b", direction=(0, 0, 0))
