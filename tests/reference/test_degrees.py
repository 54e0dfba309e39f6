"""Degrees that can be counted by hand: parameters that stand in one place, linearly."""

import mbdlft


def test_modulus_of_a_tree_of_beams() -> None:
    """A = -M^-1 (K_0 + E K_1): E is repeated as often as K_1 has rank, once for each elastic freedom."""
    section = {"density": 2700, "area": 4e-4, "I_z": 5e-8, "modulus": "E"}
    beams = [
        mbdlft.Beam(
            name=f"b{k}",
            length=1.0 + 0.1 * k,
            **section,
            elements=3 - k % 2,
            deformations=["bending_y", "axial"],
        )
        for k in range(3)
    ]
    hub = mbdlft.RigidBody(name="hub", mass=40, inertia=mbdlft.Inertia(xx=3, yy=4, zz=5))
    joints = [
        mbdlft.Fixed(
            name=f"f{k}",
            parent="hub" if k == 0 else f"b{k - 1}.tip",
            child=f"b{k}",
            orientation=[mbdlft.Rotation(axis=(0, 0, 1), angle=f"{20 + 10 * k}*deg")],
        )
        for k in range(3)
    ]
    scene = mbdlft.Scene(
        name="tree of beams",
        parameters=[mbdlft.Parameter("E", 70e9, percent=20, unit="Pa")],
        bodies=[hub, *beams],
        joints=[mbdlft.Revolute(name="j", parent="ground", child="hub", axis=(0, 0, 1)), *joints],
    )
    model = mbdlft.to_lft(scene, search=0.0)
    freedoms = sum(3 * beam.elements for beam in beams)  # a deflection, a slope, an extension
    assert len(model.states) == 2 * (1 + freedoms)
    assert model.certificate.lower_bound == model.certificate.order == (freedoms,)
    assert model.certificate.exact_bound


def test_a_lag_of_every_mode() -> None:
    """Damping d in series with each of n oscillators: d is repeated n times, whatever else is there."""
    n = 6
    rows = [["0"] * (2 * n + 1) for _ in range(2 * n + 1)]
    for k in range(n):
        rows[2 * k][2 * k + 1] = "1"
        rows[2 * k + 1][2 * k] = f"-{(k + 1) ** 2}*1e{k}"
        rows[2 * k + 1][2 * k + 1] = f"-2*d*{k + 1}"
        rows[2 * k + 1][2 * n], rows[2 * n][2 * k] = "1", f"{k + 1}e-{k}"
    problem = mbdlft.MatrixProblem(
        matrix=rows,
        parameters=[mbdlft.Parameter("d", 0.01, low=0.005, high=0.03)],
        states=[f"x{k}" for k in range(2 * n)],
    )
    certificate = mbdlft.realize(problem, search=0.0).certificate
    assert certificate.order == certificate.lower_bound == (n,)
