"""Mechanisms of the textbooks: a four-bar, two loops, a satellite with a boom."""

from collections.abc import Callable
from typing import Any

import mbdlft
from tests import kit

M = mbdlft.Parameter("m", 3.0, percent=20, unit="kg")
K = mbdlft.Parameter("k", 50.0, percent=40, unit="N/m")
LENGTH = mbdlft.Parameter("L", 0.8, low=0.6, high=1.1, unit="m")
RATE = mbdlft.Parameter("rate", 1.5, low=0.5, high=3.0, unit="rad/s")
DOWN = (0.0, 0.0, -9.81)


def link(name: str, length: float | str = 1.0, mass: float | str = 1.0, **ports: Any) -> mbdlft.RigidBody:
    """A bar along y that moves in the plane across x."""
    return kit.body(
        name,
        mass,
        (0.1, 0.08, 0.06),
        yz=0.01,
        center_of_mass=(0.0, 0.4, 0.1),
        ports={"tip": (0.0, length, 0.0), **ports},
    )


def pin(
    name: str, parent: str, child: str, position: float | str = 0.0, **fields: Any
) -> mbdlft.Revolute:
    return kit.hinge(name, parent, child, (1, 0, 0), position=position, **fields)


def closed(name: str, parent: str, child: str, kind: str = "revolute") -> mbdlft.Loop:
    axis = (1, 0, 0) if kind == "revolute" else None
    return kit.loop(name, kind, parent, child, axis=axis)


def four_bar(driven: str = "jl", kind: str = "revolute") -> mbdlft.Scene:
    """A parallelogram whose angle is a parameter, with a spring across; one joint is held."""
    free = {"jl": {}, "jc": {}, "jr": {}}
    free = {name: {} if name == driven else {"preload": 0.3} for name in free}
    return kit.scene(
        f"four_{driven}_{kind}",
        M,
        mbdlft.Angle("th", 30.0, low=10.0, high=80.0),
        K,
        LENGTH,
        mbdlft.Ground(ports={"right": (0, "1.2*L", 0), "wall": (0, -1, 0.5)}),
        link("left", "L"),
        link("coupler", "1.2*L", "m"),
        link("right", "L", 0.7),
        pin("jl", "ground", "left", "th", damping=0.4, stiffness=2.0, **free["jl"]),
        pin("jc", "left.tip", "coupler", "-th", actuator_inertia=0.05, **free["jc"]),
        pin("jr", "ground.right", "right", "th", damping=0.1, **free["jr"]),
        closed("close", "coupler.tip", "right.tip", kind),
        kit.spring("s", "coupler.tip", "ground.wall", stiffness="k", damping=1.0, force_density="0.1*k"),
        mbdlft.Position(name="p", port="coupler.center_of_mass"),
        mbdlft.Acceleration(name="a", port="coupler.tip", frame="left"),
        gravity=DOWN,
    )


def two_loops() -> mbdlft.Scene:
    """Two parallelograms in a row, closed by a hinge and a ball; the mass of the end varies."""
    bars = [link("a", "L"), link("b", 1.0, "m"), link("c", "L", 0.5), link("d", 1.0, 2.0)]
    bars += [link("e", "L", 0.8)]
    return kit.scene(
        "two_loops",
        M,
        LENGTH,
        mbdlft.Angle("th", 50.0, low=20.0, high=80.0),
        mbdlft.Ground(ports={"c": (0, 1, 0), "e": (0, 2, 0)}),
        *bars,
        pin("ja", "ground", "a", "th"),
        pin("jb", "a.tip", "b", "-th", preload=0),
        pin("jc", "ground.c", "c", "th", preload=0.2),
        pin("jd", "c.tip", "d", "-th", preload=0, stiffness=1.0),
        pin("je", "ground.e", "e", "th", preload=0, damping=0.3),
        closed("one", "b.tip", "c.tip"),
        closed("two", "d.tip", "e.tip", "spherical"),
        gravity=DOWN,
    )


def free_satellite() -> mbdlft.Scene:
    """A body that spins freely about a principal axis, with a flexible appendage."""
    return kit.scene(
        "satellite",
        M,
        RATE,
        K,
        kit.body("hub", 20.0, (3, 4, 6)),
        kit.point("tip", "0.1*m"),
        kit.free("base", "ground", "hub"),
        kit.rail("boom", "hub", "tip", (0, 0, 1), position=0.5, stiffness="k"),
        mbdlft.Momentum(name="whole"),
        spin=mbdlft.Spin(axis=(0, 0, 1), rate="rate"),
    )


def driven_four_bar() -> mbdlft.Scene:
    """The crank is driven, so nothing is free: states of the crank, the bars follow."""
    scene = four_bar("jc")
    fields = {name: getattr(scene, name) for name in type(scene).model_fields}
    joints = [
        pin("jl", "ground", "left", "th", imposed=True),
        pin("jc", "left.tip", "coupler", "-th", preload=0),
        pin("jr", "ground.right", "right", "th", preload=0),
    ]
    return mbdlft.Scene(**{**fields, "name": "driven", "joints": joints})


PLANAR: dict[str, Callable[[], mbdlft.Scene]] = {
    "four-bar": four_bar,
    "four-bar, coupler held": lambda: four_bar("jc"),
    "four-bar, rocker held": lambda: four_bar("jr"),
    "four-bar closed by a ball": lambda: four_bar("jl", "spherical"),
    "two loops": two_loops,
    "free satellite": free_satellite,
    "driven four-bar": driven_four_bar,
}
