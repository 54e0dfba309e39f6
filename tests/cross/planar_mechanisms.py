"""Mechanisms of the textbooks: four-bar, slider-crank, Watt linkage, two loops, booms, carts."""

from collections.abc import Callable
from typing import Any

import mbdlft

M = mbdlft.Parameter("m", 3.0, percent=20, unit="kg")
K = mbdlft.Parameter("k", 50.0, percent=40, unit="N/m")
LENGTH = mbdlft.Parameter("L", 0.8, low=0.6, high=1.1, unit="m")
RATE = mbdlft.Parameter("rate", 1.5, low=0.5, high=3.0, unit="rad/s")
DOWN = (0.0, 0.0, -9.81)


def link(name: str, length: float | str = 1.0, mass: float | str = 1.0, **ports: Any) -> mbdlft.RigidBody:
    """A bar along y that moves in the plane across x."""
    return mbdlft.RigidBody(
        name=name,
        mass=mass,
        center_of_mass=(0.0, 0.4, 0.1),
        inertia=mbdlft.Inertia(xx=0.1, yy=0.08, zz=0.06, yz=0.01),
        ports={"tip": (0.0, length, 0.0), **ports},
    )


def pin(
    name: str, parent: str, child: str, position: float | str = 0.0, **fields: Any
) -> mbdlft.Revolute:
    return mbdlft.Revolute(
        name=name, parent=parent, child=child, axis=(1, 0, 0), position=position, **fields
    )


def closed(name: str, parent: str, child: str, kind: str = "revolute") -> mbdlft.Loop:
    axis = (1, 0, 0) if kind == "revolute" else None
    return mbdlft.Loop(name=name, kind=kind, parent=parent, child=child, axis=axis)


def four_bar(driven: str = "jl", kind: str = "revolute") -> mbdlft.Scene:
    """A parallelogram whose angle is a parameter, with a spring across; one joint is held."""
    free = {"jl": {}, "jc": {}, "jr": {}}
    free = {name: {} if name == driven else {"preload": 0.3} for name in free}
    return mbdlft.Scene(
        name=f"four_{driven}_{kind}",
        gravity=DOWN,
        parameters=[M, mbdlft.Angle("th", 30.0, low=10.0, high=80.0), K, LENGTH],
        bodies=[
            mbdlft.Ground(ports={"right": (0, "1.2*L", 0), "wall": (0, -1, 0.5)}),
            link("left", "L"),
            link("coupler", "1.2*L", "m"),
            link("right", "L", 0.7),
        ],
        joints=[
            pin("jl", "ground", "left", "th", damping=0.4, stiffness=2.0, **free["jl"]),
            pin("jc", "left.tip", "coupler", "-th", actuator_inertia=0.05, **free["jc"]),
            pin("jr", "ground.right", "right", "th", damping=0.1, **free["jr"]),
        ],
        loops=[closed("close", "coupler.tip", "right.tip", kind)],
        loads=[
            mbdlft.Spring(
                name="s",
                parent="coupler.tip",
                child="ground.wall",
                stiffness="k",
                damping=1.0,
                force_density="0.1*k",
            )
        ],
        sensors=[
            mbdlft.Position(name="p", port="coupler.center_of_mass"),
            mbdlft.Acceleration(name="a", port="coupler.tip", frame="left"),
        ],
    )


def slider_crank() -> mbdlft.Scene:
    """Crank, connecting rod of the same length, slider on a rail along y."""
    length, cosine = 0.8, 0.5  # of 60 degrees
    return mbdlft.Scene(
        name="slider_crank",
        gravity=DOWN,
        parameters=[M, K],
        bodies=[link("crank", length), link("rod", length), mbdlft.RigidBody(name="slider", mass="m")],
        joints=[
            pin("jc", "ground", "crank", "60*deg"),
            pin("jr", "crank.tip", "rod", "-120*deg", preload=0, damping=0.2),
            mbdlft.Prismatic(
                name="rail",
                parent="ground",
                child="slider",
                axis=(0, 1, 0),
                position=2 * length * cosine,
                stiffness="k",
                damping=3.0,
                preload=1.5,
            ),
        ],
        loops=[closed("pin", "rod.tip", "slider")],
        sensors=[mbdlft.Momentum(name="whole")],
    )


def watt() -> mbdlft.Scene:
    """Watt's linkage: two long levers and a short coupler; a carriage in the middle on a spring."""
    return mbdlft.Scene(
        name="watt",
        gravity=DOWN,
        parameters=[M, K, LENGTH],
        bodies=[
            mbdlft.Ground(ports={"right": (0, "2*L", 0.5), "below": (0, "L", -2)}),
            link("left", "L"),
            link("coupler", 0.5, middle=(0, 0.25, 0)),
            link("right", "L", 0.7),
            mbdlft.PointMass(name="carriage", mass="m"),
        ],
        joints=[
            pin("jl", "ground", "left"),
            pin("jc", "left.tip", "coupler", "90*deg", preload=0),
            pin("jr", "ground.right", "right", "180*deg", preload=0, stiffness=4.0),
            mbdlft.Fixed(name="on", parent="coupler.middle", child="carriage", axis=(1, 0, 0)),
        ],
        loops=[closed("pin", "coupler.tip", "right.tip")],
        loads=[
            mbdlft.Spring(
                name="s",
                parent="coupler.middle",
                child="ground.below",
                stiffness="k",
                force_density="-0.3*k",
            )
        ],
    )


def two_loops() -> mbdlft.Scene:
    """Two parallelograms in a row, closed by a hinge and a ball; the mass of the end varies."""
    bars = [link("a", "L"), link("b", 1.0, "m"), link("c", "L", 0.5), link("d", 1.0, 2.0)]
    bars += [link("e", "L", 0.8)]
    return mbdlft.Scene(
        name="two_loops",
        gravity=DOWN,
        parameters=[M, LENGTH, mbdlft.Angle("th", 50.0, low=20.0, high=80.0)],
        bodies=[mbdlft.Ground(ports={"c": (0, 1, 0), "e": (0, 2, 0)}), *bars],
        joints=[
            pin("ja", "ground", "a", "th"),
            pin("jb", "a.tip", "b", "-th", preload=0),
            pin("jc", "ground.c", "c", "th", preload=0.2),
            pin("jd", "c.tip", "d", "-th", preload=0, stiffness=1.0),
            pin("je", "ground.e", "e", "th", preload=0, damping=0.3),
        ],
        loops=[closed("one", "b.tip", "c.tip"), closed("two", "d.tip", "e.tip", "spherical")],
    )


def guyed_mast() -> mbdlft.Scene:
    """An inverted pendulum between two pretensioned stays, the tension found by the trim."""
    stay = {"parent": "mast.tip", "stiffness": "k", "damping": 1.5}
    return mbdlft.Scene(
        name="guyed_mast",
        gravity=DOWN,
        parameters=[M, K, LENGTH],
        bodies=[
            mbdlft.Ground(ports={"left": (0, -1, 0), "right": (0, 0.7, 0.1)}),
            mbdlft.PointMass(name="mast", mass="m", ports={"foot": (0, 0, "-L"), "tip": (0, 0.1, 0)}),
        ],
        joints=[pin("foot", "ground", "mast.foot", preload=0, actuator_inertia=0.1)],
        loads=[
            mbdlft.Spring(name="left", child="ground.left", force_density=8.0, **stay),
            mbdlft.Spring(name="right", child="ground.right", **stay),
        ],
    )


def boom_on_a_hub() -> mbdlft.Scene:
    """Hub free to turn, boom that flaps and lags, as a rotor blade."""
    return mbdlft.Scene(
        name="boom",
        spin=mbdlft.Spin(axis=(0, 0, 1), rate="rate"),
        gravity=(0, 0, -3.0),
        parameters=[M, RATE, LENGTH],
        bodies=[
            mbdlft.RigidBody(
                name="hub", mass=10.0, inertia=mbdlft.Inertia(xx=1, yy=1, zz=2), ports={"e": (0.3, 0, 0)}
            ),
            mbdlft.RigidBody(
                name="blade",
                mass="m",
                center_of_mass=("0.5*L", 0, 0),
                inertia=mbdlft.Inertia(xx=0.05, yy=0.2, zz=0.25),
            ),
        ],
        joints=[
            mbdlft.Revolute(name="base", parent="ground", child="hub", axis=(0, 0, 1), preload=0),
            mbdlft.Universal(
                name="flap", parent="hub.e", child="blade", axis1=(0, -1, 0), axis2=(0, 0, 1)
            ),
        ],
        sensors=[mbdlft.Gyro(name="gyro", port="blade"), mbdlft.JointWrench(name="root", joint="flap")],
    )


def slider_in_a_slot() -> mbdlft.Scene:
    """A mass in two slots of a turntable, with springs: Coriolis couples them."""
    return mbdlft.Scene(
        name="slot",
        spin=mbdlft.Spin(axis=(0, 0, 2), rate="rate"),
        parameters=[M, RATE, K],
        bodies=[mbdlft.PointMass(name="carriage", mass=0.5), mbdlft.PointMass(name="bead", mass="m")],
        joints=[
            mbdlft.Prismatic(
                name="x", parent="ground", child="carriage", axis=(1, 0, 0), position=0.4, stiffness="k"
            ),
            mbdlft.Prismatic(
                name="y", parent="carriage", child="bead", axis=(0, 1, 0), position=0.2, stiffness="k"
            ),
        ],
    )


def free_satellite() -> mbdlft.Scene:
    """A body that spins freely about a principal axis, with a flexible appendage."""
    return mbdlft.Scene(
        name="satellite",
        spin=mbdlft.Spin(axis=(0, 0, 1), rate="rate"),
        parameters=[M, RATE, K],
        bodies=[
            mbdlft.RigidBody(name="hub", mass=20.0, inertia=mbdlft.Inertia(xx=3, yy=4, zz=6)),
            mbdlft.PointMass(name="tip", mass="0.1*m"),
        ],
        joints=[
            mbdlft.Free(name="base", parent="ground", child="hub"),
            mbdlft.Prismatic(
                name="boom", parent="hub", child="tip", axis=(0, 0, 1), position=0.5, stiffness="k"
            ),
        ],
        sensors=[mbdlft.Momentum(name="whole")],
    )


def shaken_cart() -> mbdlft.Scene:
    """A pendulum on a cart whose acceleration is imposed, on a shaking ground."""
    return mbdlft.Scene(
        name="shaken",
        gravity=DOWN,
        parameters=[M, LENGTH],
        bodies=[
            mbdlft.RigidBody(name="cart", mass=2.0),
            mbdlft.PointMass(name="bob", mass="m", ports={"o": (0, 0, "L")}),
        ],
        joints=[
            mbdlft.Prismatic(name="x", parent="ground", child="cart", axis=(0, 1, 0), imposed=True),
            pin("j", "cart", "bob.o", preload=0, damping=0.1),
        ],
        inputs=["x.acceleration", "j.torque", "ground.acceleration.y", "ground.acceleration.z"],
        outputs=["j.angle", "x.acceleration", "imu.y"],
        sensors=[mbdlft.Accelerometer(name="imu", port="bob")],
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
    "slider-crank": slider_crank,
    "Watt": watt,
    "two loops": two_loops,
    "guyed mast": guyed_mast,
    "boom on a hub": boom_on_a_hub,
    "slider in a turning slot": slider_in_a_slot,
    "free satellite": free_satellite,
    "shaken cart": shaken_cart,
    "driven four-bar": driven_four_bar,
}
