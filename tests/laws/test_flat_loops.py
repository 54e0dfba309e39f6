"""Closed loops that pass a position where branches of their motion meet are never called proved."""

import numpy as np
import pytest

import mbdlft
from mbdlft import Angle, Inertia, Loop, Parameter, Revolute, RigidBody, Scene
from mbdlft.base.errors import SceneError, WellPosednessError
from mbdlft.multibody.body import Ground

_INERTIA = Inertia(xx=0.1, yy=0.12, zz=0.09)


def parallelogram(seed: int, *, flat: bool) -> Scene:
    """Bars of length L on pivots d apart, at the angle th from the line of the pivots; flat at th = 0.

    One to six parameters: th, then lengths and masses. Nominal is never flat.
    """
    draw = np.random.default_rng(seed)
    count = 1 + seed % 6
    nominal = float(draw.uniform(20.0, 70.0))
    low = -nominal * draw.uniform(0.2, 0.9) if flat else nominal * draw.uniform(0.1, 0.4)
    parameters = [Angle("th", nominal, low=float(low), high=nominal + 15.0)]
    values: dict[str, str | float] = {}
    for k, name in enumerate(("L", "d", "m_lo", "m_up", "m_cp")):
        size = float(draw.uniform(0.4, 1.5))
        values[name] = size
        if k < count - 1:
            unit = "m" if name in "Ld" else "kg"
            parameters.append(Parameter(name, size, percent=float(draw.uniform(5, 30)), unit=unit))
            values[name] = name
    d = values["d"]

    def bar(name: str) -> RigidBody:
        return RigidBody(
            name=name,
            mass=values[f"m_{name}"],
            center_of_mass=(0, 0.25, 0.02),
            inertia=_INERTIA,
            ports={"t": (0, values["L"], 0)},
        )

    coupler = RigidBody(
        name="cp",
        mass=values["m_cp"],
        inertia=_INERTIA,
        ports={"u": (0, d, 0)},
        center_of_mass=(0, 0.1, 0),
    )
    axis = (1, 0, 0)
    return Scene(
        name="parallelogram",
        gravity=(0, 0, 0 if seed % 2 else -9.81),
        parameters=parameters,
        bodies=[Ground(ports={"u": (0, d, 0)}), bar("lo"), bar("up"), coupler],
        joints=[
            Revolute(name="a", parent="ground", child="lo", axis=axis, position="th", stiffness=50.0),
            Revolute(name="b", parent="ground.u", child="up", axis=axis, position="th", preload=0),
            Revolute(name="c", parent="lo.t", child="cp", axis=axis, position="-th", preload=0),
        ],
        loops=[Loop(name="h", kind="revolute", parent="up.t", child="cp.u", axis=axis)],
    )


@pytest.mark.parametrize("seed", range(12))
def test_flat_positions_in_the_range_are_refused(seed: int) -> None:
    with pytest.raises((SceneError, WellPosednessError), match=r"at .*th = -?\d|singular position"):
        mbdlft.to_lft(parallelogram(seed, flat=True), search=0.0)


@pytest.mark.parametrize("seed", range(12))
def test_ranges_without_flat_positions_are_proved(seed: int) -> None:
    model = mbdlft.to_lft(parallelogram(seed, flat=False), search=0.0)
    assert model.certificate.well_posed == "proved"


def test_a_coupler_that_shrinks_to_a_point_is_refused() -> None:
    """At d = 0 both bars hang on one pivot, and the loop has a second freedom."""
    scene = parallelogram(2, flat=False)
    assert "d" in [p.name for p in scene.parameters]
    wide = tuple(
        Parameter("d", 0.1, low=-0.1, high=0.3, unit="m") if p.name == "d" else p
        for p in scene.parameters
    )
    with pytest.raises(WellPosednessError, match=r"d = -?\d|at .*d ="):
        mbdlft.to_lft(scene.model_copy(update={"parameters": wide}), search=0.0)
