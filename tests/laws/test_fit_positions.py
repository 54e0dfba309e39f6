"""Laws of fitted positions: inside the bound everywhere, accepted up to it, never beyond."""

import math
from functools import partial
from pathlib import Path
from typing import Any

import casadi as ca
import mpmath
import numpy as np
import pytest

import mbdlft
from mbdlft import Fit, Parameter, Scene
from mbdlft.base.expression import evaluate, parse
from mbdlft.multibody.equilibrium.fit import fit_equilibrium
from tests import kit
from tests.close import SCENARIO, roundoff, target
from tests.laws.test_equilibrium import four_bar, whirling

G = 9.81
MASS = Parameter("m", 2.0, percent=30, unit="kg")
STIFFNESS = Parameter("k", 20.0, percent=20, unit="N m/rad")
VALUES = [(m, k) for m in (1.4, 1.7, 2.0, 2.35, 2.6) for k in (16.0, 18.5, 20.0, 24.0)]


def sag(**fields: Any) -> Scene:
    """A mass on a hinge with a spring: k (theta - 1) + m g 0.8 sin(theta) = 0."""
    spring = {"position": 1.0, "preload": 0.0, "stiffness": "k"}
    return kit.scene(
        "sag",
        MASS,
        STIFFNESS,
        kit.point("bob", "m", ports={"top": (0, 0, 0.8)}),
        kit.hinge("hinge", "ground", "bob.top", (1, 0, 0), **{**spring, **fields}),
        gravity=(0, 0, -G),
    )


def sagging(m: float, k: float) -> float:
    """Its angle to 50 digits."""
    mpmath.mp.dps = 50

    def moment(theta: mpmath.mpf) -> mpmath.mpf:
        lever = mpmath.mpf(m) * mpmath.mpf(G) * mpmath.mpf(0.8)
        return mpmath.mpf(k) * (theta - 1) + lever * mpmath.sin(theta)

    return float(mpmath.findroot(moment, 0.5))


@pytest.mark.parametrize("tolerance", [1.0, 0.1])
def test_a_large_tolerance_is_met_by_a_nearer_fit(tolerance: float) -> None:
    """The coarse fit of t + 100 t^3 = p has boxes around it in which the slope is zero."""
    t, p = ca.SX.sym("t"), ca.SX.sym("p")
    steep = ca.Function("steep", [t, p], [t + 100.0 * t**3 - p])
    fit = fit_equilibrium(steep, [1.0], [-2.0], [2.0], [0.2], tolerance)
    roots = np.linspace(-0.25, 0.25, 401)
    values = fit((roots + 100.0 * roots**3)[:, None])[:, 0]
    assert np.max(np.abs(values - roots)) <= fit.bound[0] <= tolerance


def angle(text: str, values: dict[str, float]) -> float:
    """Value of theta0 + 2*atan(r)."""
    start, _, tangent = str(text).partition(" + 2*atan")
    return float(start) + 2.0 * float(np.arctan(evaluate(parse(tangent), values)))


@pytest.mark.parametrize("tolerance", [1e-3, 1e-6])
def test_bound_holds(tolerance: float) -> None:
    found = mbdlft.fit_positions(sag(), ["hinge"], tolerance)
    assert found.fit is not None
    bound = found.fit.bounds["hinge.angle"]
    assert bound <= tolerance
    joint: Any = found.joints[0]
    errors, torques = [], []
    for m, k in VALUES:
        theta = sagging(m, k)
        errors.append(abs(angle(joint.position, {"m": m, "k": k}) - theta))
        torques.append(abs(float(evaluate(parse(joint.preload), {"m": m, "k": k})) + k * (theta - 1)))
    assert max(errors) <= bound
    assert max(torques) <= found.fit.bounds["hinge.torque"]
    assert max(errors) >= 0.05 * bound  # a bound that is far too large promises little


def test_model_of_a_fit() -> None:
    """The certificate says that the model is a fit, and it is near that of the true position."""
    found = mbdlft.fit_positions(sag(), ["hinge"], 1e-6)
    model = mbdlft.to_lft(found, search=0.0)
    assert found.fit is not None
    assert not model.certificate.exact
    assert not model.certificate.minimal
    assert model.certificate.fit_error_bound == found.fit.bounds["hinge.angle"]
    assert model.certificate.max_relative_error <= SCENARIO
    for m, k in VALUES:
        exact = -(k + m * G * 0.8 * np.cos(sagging(m, k))) / (m * 0.64)
        near = mbdlft.matrices_at(model, {"m": m, "k": k}).A[1, 0]
        assert abs(near - exact) <= G / 0.8 * model.certificate.fit_error_bound + SCENARIO * abs(exact)


def test_archive_and_text_keep_it(tmp_path: Path) -> None:
    found = mbdlft.fit_positions(sag(), ["hinge"], 1e-3)
    assert mbdlft.scene_from_toml(mbdlft.scene_to_toml(found)) == found
    model = mbdlft.to_lft(found, search=0.0)
    mbdlft.save(tmp_path / "sag.h5", model)
    assert mbdlft.load(tmp_path / "sag.h5").certificate == model.certificate
    small = mbdlft.truncate(model, 0.2)
    assert small.certificate.fit_error_bound == model.certificate.fit_error_bound
    mbdlft.save(tmp_path / "small.h5", small)
    assert mbdlft.load(tmp_path / "small.h5").certificate == small.certificate


def test_residual_is_accepted_up_to_the_bound_only() -> None:
    found = mbdlft.fit_positions(sag(), ["hinge"], 1e-4)
    assert found.fit is not None
    joint: Any = found.joints[0]
    mbdlft.to_lft(found, search=0.0)
    smaller = {name: 0.1 * bound for name, bound in found.fit.bounds.items()}
    wrong = {
        "smaller bounds": found.model_copy(update={"fit": Fit(tolerance=1e-4, bounds=smaller)}),
        "no bounds": found.model_copy(update={"fit": Fit(tolerance=1e-4, bounds={})}),
        "moved": found.model_copy(
            update={"joints": (joint.model_copy(update={"position": f"{joint.position} + 0.001"}),)}
        ),
        "wider range": found.model_copy(
            update={"parameters": (Parameter("m", 2.0, percent=80, unit="kg"), STIFFNESS)}
        ),
    }
    for scene in wrong.values():
        with pytest.raises(mbdlft.TrimError, match=r"hinge\.torque misses"):
            mbdlft.to_lft(scene, search=0.0)


DECLARED = math.hypot(0.9 - 0.8 * math.sin(0.9), 0.8 * math.cos(0.9))  # where the scene has it


@pytest.mark.parametrize(
    "tension", [{"rest_length": 0.4}, {"force_density": f"k*(1 - {0.4 / DECLARED!r})"}]
)
def test_cable(tension: dict[str, Any]) -> None:
    """The tension of the cable is fitted with the angle; lengths to 50 digits."""
    k = Parameter("k", 300.0, percent=20, unit="N/m")
    scene = sag(stiffness=0.0, position=0.9).model_copy(
        update={
            "parameters": (MASS, k),
            "loads": (kit.spring("cable", "ground.hook", "bob", stiffness="k", **tension),),
        }
    )
    scene = scene.model_copy(
        update={"bodies": (*scene.bodies, mbdlft.Ground(ports={"hook": (0, 0.9, 0)}))}
    )
    found = mbdlft.fit_positions(scene, ["hinge"], 1e-4)
    model = mbdlft.to_lft(found, search=0.0)
    assert model.certificate.max_relative_error <= SCENARIO
    assert found.fit is not None
    mpmath.mp.dps = 50
    for m, stiffness in ((1.4, 240.0), (2.2, 333.0), (2.6, 360.0)):

        def moment(theta: mpmath.mpf, m: float, stiffness: float) -> mpmath.mpf:
            y, z = mpmath.mpf(0.8) * mpmath.sin(theta), -mpmath.mpf(0.8) * mpmath.cos(theta)
            length = mpmath.sqrt((mpmath.mpf(0.9) - y) ** 2 + z**2)
            density = mpmath.mpf(stiffness) * (1 - mpmath.mpf(0.4) / length)
            # about x: y F_z - z F_y
            return y * (-mpmath.mpf(m) * mpmath.mpf(G) - density * z) - z * density * (
                mpmath.mpf(0.9) - y
            )

        values = {"m": m, "k": stiffness}
        theta = mpmath.findroot(partial(moment, m=m, stiffness=stiffness), 1.04)
        near = angle(found.joints[0].position, values)  # type: ignore[attr-defined]
        assert abs(near - float(theta)) <= found.fit.bounds["hinge.angle"]
        length = float(mpmath.hypot(mpmath.mpf(0.9) - 0.8 * mpmath.sin(theta), 0.8 * mpmath.cos(theta)))
        density = stiffness * (1 - 0.4 / length)
        load: Any = found.loads[0]
        off = abs(float(evaluate(parse(load.force_density), values)) - density)
        assert off <= found.fit.bounds["cable.force_density"]


def test_loop_whose_shape_depends_on_a_length() -> None:
    """A four-bar with an uncertain coupler: its angles follow, and the gap that is left is explained."""
    length = Parameter("L", 1.0, percent=10, unit="m")
    scene = four_bar().model_copy(update={"parameters": (length,)})
    coupler = scene.bodies[1].model_copy(
        update={"ports": {"tip": (0.0, "L", 0.0)}, "center_of_mass": (0.0, "0.5*L", 0.0)}
    )
    scene = scene.model_copy(update={"bodies": (scene.bodies[0], coupler, *scene.bodies[2:])})
    found = mbdlft.fit_positions(scene, ["b", "c"], 1e-4)
    model = mbdlft.to_lft(found, search=0.0)
    assert model.certificate.max_relative_error <= SCENARIO
    assert found.fit is not None
    for value in (0.9, 0.97, 1.08):
        point = mbdlft.find_equilibrium(scene, {"L": value})
        for k, name in ((1, "b.angle"), (2, "c.angle")):
            near = angle(found.joints[k].position, {"L": value})  # type: ignore[attr-defined]
            off = np.remainder(near - point.positions[name] + np.pi, 2 * np.pi) - np.pi
            assert abs(off) <= found.fit.bounds[name]
        torque = mbdlft.trim_at(model, {"L": value})[0]
        target(torque, point.efforts["a.torque"], 1e2 * model.certificate.fit_error_bound)
    wrong = found.model_copy(update={"fit": None})
    with pytest.raises(mbdlft.SceneError, match="do not meet"):
        mbdlft.to_lft(wrong, search=0.0)


def test_units_and_unused_parameters() -> None:
    """Parameters in grams and with another unit are those in kilograms; the others are left alone."""
    other = Parameter("m", 2000.0, percent=30, unit="g")
    idle = Parameter("c", 1.0, percent=10, unit="N m s/rad")
    scene = sag(damping="c").model_copy(update={"parameters": (other, STIFFNESS, idle)})
    found = mbdlft.fit_positions(scene, ["hinge"], 1e-4)
    assert found.fit is not None
    position = found.joints[0].position  # type: ignore[attr-defined]
    for m, k in VALUES:
        off = abs(angle(position, {"m": m, "k": k}) - sagging(m, k))
        assert off <= found.fit.bounds["hinge.angle"]
    model = mbdlft.to_lft(found, search=0.0)
    assert model.certificate.max_relative_error <= SCENARIO
    assert dict(model.lft.blocks)["c"] == 1


def test_spinning_pendulum() -> None:
    """cos(theta) = g/(L rate^2), over a range of rates."""
    rate = Parameter("rate", 5.0, low=4.4, high=6.0, unit="rad/s")
    found = mbdlft.fit_positions(whirling("rate", parameters=(MASS, rate)), ["hinge"], 1e-5)
    assert found.fit is not None
    position = found.joints[0].position  # type: ignore[attr-defined]
    for value in np.linspace(4.4, 6.0, 17):
        off = abs(angle(position, {"rate": float(value)}) - np.arccos(G / (0.8 * value**2)))
        assert off <= found.fit.bounds["hinge.angle"]
    assert mbdlft.to_lft(found, search=0.0).certificate.max_relative_error <= SCENARIO
    wide = Parameter("rate", 5.0, low=3.0, high=6.0, unit="rad/s")
    with pytest.raises(mbdlft.TrimError, match=r"rate = 3\.50.*singular"):
        mbdlft.fit_positions(whirling("rate", parameters=(MASS, wide)), ["hinge"], 1e-5)


def test_position_that_is_rational_is_fitted_as_such() -> None:
    """A mass on a spring: z = -m g/k, where k is a number the fit is exact and of the first degree."""
    scene = kit.scene(
        "weight",
        MASS,
        kit.point("bob", "m"),
        kit.rail("slide", "ground", "bob", (0, 0, 1), preload=0.0, stiffness=50.0),
        gravity=(0, 0, -G),
    )
    found = mbdlft.fit_positions(scene, ["slide"], 1e-6)
    position: Any = found.joints[0].position  # type: ignore[attr-defined]
    for m in (1.4, 2.0, 2.5):
        near = float(evaluate(parse(position), {"m": m}))
        roundoff(near, -m * G / 50.0, kappa=1e3)
