"""A hub with elastic beams one behind the other on sprung hinges: what elastic models are measured on."""

from collections.abc import Sequence

import mbdlft
from mbdlft import Beam, Fixed, Inertia, Planar, Revolute, RigidBody, Scene

NOMINAL = {  # an aluminium beam of 1 m
    "L": (1.0, "m"),
    "E": (70e9, "Pa"),
    "rho": (2700.0, "kg/m^3"),
    "A": (4e-4, "m^2"),
    "I": (5e-8, "m^4"),
}
_PERCENT = 20


def hub(beams: int, elements: int, uncertain: Sequence[str] = (), *, is_spatial: bool = False) -> Scene:
    """Torques in, accelerations and position of the tip out; each beam has a length of its own.

    Parameters
    ----------
    beams, elements : int
        Of the chain, and of each beam.
    uncertain : keys of `NOMINAL`
        What has a range of 20 %.
    is_spatial : bool
        The base is free, and the beams also bend across, twist and stretch.
    """
    parameters: list[mbdlft.Parameter] = []

    def quantity(key: str, name: str) -> str | float:
        value, unit = NOMINAL[key]
        if key not in uncertain:
            return value
        if name not in [parameter.name for parameter in parameters]:
            parameters.append(mbdlft.Parameter(name, value, percent=_PERCENT, unit=unit))
        return name

    def beam(k: int) -> Beam:
        more = {"I_y": 5e-8, "shear_modulus": 26e9, "torsion_constant": 1e-7} if is_spatial else {}
        return Beam(
            name=f"beam{k}",
            length=quantity("L", f"L{k}"),
            density=quantity("rho", "rho"),
            area=quantity("A", "A"),
            modulus=quantity("E", "E"),
            I_z=quantity("I", "I"),
            elements=elements,
            stiffness_damping=1e-4,
            deformations=_DEFORMATIONS if is_spatial else ["bending_y"],
            **more,
        )

    chain = [beam(k) for k in range(beams)]
    return Scene(
        name=f"hub with {beams} beams of {elements} elements",
        parameters=parameters,
        bodies=[
            RigidBody(name="hub", mass=40, inertia=Inertia(xx=3, yy=4, zz=5)),
            RigidBody(name="tip", mass=2, inertia=Inertia(xx=0.02, yy=0.03, zz=0.04)),
            *chain,
        ],
        joints=[
            _base(is_spatial=is_spatial),
            *(_hinge(k) for k in range(beams)),
            Fixed(name="end", parent=f"beam{beams - 1}.tip", child="tip"),
        ],
        loads=[mbdlft.Torque(name="T", port="hub", direction=(0, 0, 1), magnitude=0)],
        sensors=[mbdlft.Acceleration(name="a", port="tip"), mbdlft.Position(name="p", port="tip")],
        inputs=["T.torque", *(f"hinge{k}.torque" for k in range(beams))],
        outputs=["a.x", "a.y", "p.y"],
    )


_DEFORMATIONS = ["axial", "torsion", "bending_y", "bending_z"]


def _base(*, is_spatial: bool) -> mbdlft.Free | Planar:
    if is_spatial:
        return mbdlft.Free(name="base", parent="ground", child="hub", preload=(0,) * 6)
    return Planar(name="base", parent="ground", child="hub", axis=(0, 0, 1), preload=(0, 0, 0))


def _hinge(k: int) -> Revolute:
    return Revolute(
        name=f"hinge{k}",
        parent=f"beam{k - 1}.tip" if k else "hub",
        child=f"beam{k}",
        axis=(0, 0, 1),
        position=0.3 if k else 0.0,
        stiffness=40.0,
        damping=0.1,
    )
