"""Chains of equal links with masses, lengths and angles as parameters."""

import mbdlft


def chain(links: int, *, spatial: bool) -> mbdlft.Scene:
    """Links on revolute joints, in the plane or with axes x and z in turn; 3 parameters each."""
    parameters: list[mbdlft.Parameter] = []
    for k in range(links):
        parameters.append(mbdlft.Parameter(f"m{k}", 2.0, percent=20, unit="kg"))
        parameters.append(mbdlft.Parameter(f"L{k}", 1.0, percent=20, unit="m"))
        parameters.append(mbdlft.Angle(f"t{k}", 20.0 + 10 * (k % 6), 0.0, 80.0))
    bodies = [
        mbdlft.RigidBody(
            name=f"link{k}",
            mass=f"m{k}",
            center_of_mass=(0, f"0.5*L{k}", 0),
            inertia=mbdlft.Inertia(xx=0.1, yy=0.05, zz=0.1),
            ports={"tip": (0, f"L{k}", 0)},
        )
        for k in range(links)
    ]
    joints = [
        mbdlft.Revolute(
            name=f"joint{k}",
            parent=f"link{k - 1}.tip" if k else "ground",
            child=f"link{k}",
            axis=(0, 0, 1) if spatial and k % 2 else (1, 0, 0),
            position=f"t{k}",
        )
        for k in range(links)
    ]
    return mbdlft.Scene(
        name="chain", gravity=(0, 0, -9.81), parameters=parameters, bodies=bodies, joints=joints
    )
