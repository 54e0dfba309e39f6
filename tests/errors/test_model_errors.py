"""Errors of building a model and of asking a finished one: class and message."""

from dataclasses import replace

import casadi as ca
import control
import numpy as np
import pytest

import mbdlft
from mbdlft.export import lpv_grid
from mbdlft.multibody.body import Inertia
from mbdlft.problem.linearization import relinearize
from mbdlft.problem.relations import trim_relations
from mbdlft.show import save_singular_values
from tests import kit
from tests.errors.scenes import ARM, cart
from tests.errors.table import refused, says

MASSES = [mbdlft.Parameter("mass", 1, 0.5, 2, unit="kg"), mbdlft.Parameter("load", 1, 0.5, 2, unit="kg")]


@pytest.fixture(scope="module")
def model():
    return mbdlft.to_lft(cart("mass + load", MASSES), search=0.0)


@pytest.fixture(scope="module")
def equations():
    return mbdlft.assemble(cart("mass + load", MASSES, gravity=(0, -9.81, 0)))


TWO_LINKS = mbdlft.assemble(mbdlft.scene_from_toml(ARM))

test_messages = refused(
    r"""
> {} => AnalysisError:
to_lft(cart("m", [Parameter("m", 1, 0, 2, unit="kg")]), search=0.0)
    => WellPosednessError: scene 'cart_on_rail': the model is singular at m = 0 kg: the determinant of
        its equations vanishes there. Narrow the ranges, or keep masses and inertias away from zero.
to_lft(cart("m", [Parameter("m", 1, 0.01, 2, unit="kg")]), search=0.0) => accepted
to_lft(cart("mass*(r - 0.7)^2", [MASSES[0], Parameter("r", 0.5, 0.1, 0.9)]), search=0.0)
    => WellPosednessError: scene 'cart_on_rail' … singular
to_lft(two_rails(5), search=0.0) => accepted
to_lft(two_rails(-30), search=0.0) => WellPosednessError: scene 'two_rails' … singular
relinearize(assemble(cart('m', [Parameter('m', 1, 0, 2, unit='kg')])), [0], [0], np.array([[1.0],
    [0.0]]))
    => WellPosednessError: scene 'cart_on_rail': the mass matrix is singular at a point of the parameter
        range: nothing with enough inertia moves with rail.velocity. Keep masses and inertias away from
        zero
solve_trim(replace(equations, residual=ca.substitute(equations.residual, equations.u, 0)))
    => TrimError: scene 'cart_on_rail': the equilibrium does not determine rail.force, which moves nothing
trim_relations(replace(equations, residual=ca.substitute(equations.residual, equations.u, 0)))
    => TrimError: scene 'cart_on_rail': the equilibrium does not determine
solve_trim((lambda a, both: replace(a, residual=ca.substitute(a.residual, a.u, ca.vertcat(both,
    both))))(TWO_LINKS, TWO_LINKS.u[0] + TWO_LINKS.u[1]))
    => TrimError: scene 'two_link_arm': the equilibrium does not determine the trim unknowns
        shoulder.torque, elbow.torque: they are redundant, 1 too many.
solve_trim(replace(equations, unknown=(), given=ca.SX([2.5])))
    => TrimError: scene 'cart_on_rail': no equilibrium at load = 1 kg, mass = 1 kg: rail.force misses …
        N, and nothing is unknown. Leave out a preload or a load's magnitude that can balance it,
replace(model, parameters=model.parameters[:1])
    => StructureError: model 'cart_on_rail': the blocks ['load', 'mass'] are not the parameters
        ['load'].
replace(model, inputs=())
    => StructureError: model 'cart_on_rail': the signals need shape (3, 2), the LFT has (3, 3).
matrices_at(model, {"mass": np.ones((2, 2))}) => StructureError: (2, 2)
model.at(mas=1.0) => StructureError: model 'cart_on_rail': unknown parameter 'mas'. Did you mean 'mass'?
model.at([1.0])
    => StructureError: model 'cart_on_rail': expected values by name, such as {'load': 1.0}, got [1.0].
model.at({1: 1.0}) => StructureError: model 'cart_on_rail': unknown parameter '1'. Existing: load, mass.
model.with_range([1.0]) => StructureError: model 'cart_on_rail': expected values by name … got [1.0].
model["rail.position", []].at()
    => StructureError: model 'cart_on_rail': python-control has no system with one output and no inputs
lpv_grid(model["rail.position", []], {"mass": 2}) => StructureError: python-control has no system
mbdlft.as_system(control.ss(-1, 1, 1, 0), name="lag")[[], []].at()
    => StructureError: model 'lag': python-control has no system with one state and no inputs
[model[[], []].at().nstates, model[[], "rail.force"].at().ninputs] => accepted
trim_at(replace(model, trim=replace(model.trim, lft=None)), {})
    => StructureError: model 'cart_on_rail' was stored without the LFT of its trim.
frequency_response(to_lft(cart('mass + load', MASSES, joint={'stiffness': 0.0}), search=0.0), {}, [1.0,
    0.0])
    => model 'cart_on_rail': omega = 0 rad/s is a pole at one of the samples, where the response is
        infinite. Leave this frequency out or add damping.
grid(MASSES, {"mas": 2}) => grid: unknown parameter 'mas'. Did you mean 'mass'?
grid(MASSES, {"mass": 0}) => grid: counts must be whole numbers of at least 1, got {'mass': 0}.
grid(MASSES, {"mass": 2.5}) => grid: counts must be whole numbers of at least 1, got {'mass': 2.5}.
random(MASSES, -3) => random: expected a number of points such as 1000, got -3.
grid(MASSES, {"mass": 10**4, "load": 10**4})
    => grid: 1e+08 points are more than 4194304; use random points.
corners([Parameter(f"p{k}", 1, percent=10) for k in range(23)])
    => grid: 8.39e+06 points are more than 4194304; use random points.
matrices_at(model, [1.0])
    => StructureError: model 'cart_on_rail': expected values by name, such as {'load': 1.0}, got [1.0].
> {to_lft(cart('mass + load', MASSES)|realize([['1']], []}, search={}) => SceneError: search: expected
    units of work, 0 for no search, got
-1.0 => -1.0.
float('nan') => nan.
'long' => 'long'.
> frequency_response(model, dict(), {}) => AnalysisError: model 'cart_on_rail': omega: expected finite
    frequencies (rad/s), got
float('nan') => nan.
[1.0, float('inf')] => [1.0, inf].
{['fast']|1j} => {0}.
> solve_trim(equations, {}) => TrimError:
{"mas": 1.0} => trim: unknown parameter 'mas'. Did you mean 'mass'? Existing: load, mass.
{"mass": 3.0} => trim: mass = 3 is outside its range [0.5, 2] kg.
{"mass": np.nan} => trim: mass = nan is outside its range [0.5, 2] kg.
> to_lft(cart({}, MASSES), search=0.0) => WellPosednessError: scene 'cart_on_rail' … mass
0.0
"0*mass"
> {matrices_at|trim_at}(model, {}) => StructureError: model 'cart_on_rail':
{"mas": 1.0} => unknown parameter 'mas'. Did you mean 'mass'? Existing: load, mass.
{"mass": 3.0} => mass = 3 is outside its range [0.5, 2] kg. Widen the range in the scene and linearize
{"mass": [1.0, 0.4]} => mass = 0.4 is outside its range [0.5, 2] kg.
{"mass": np.nan} => mass = nan is outside its range
{"mass": [1.0, 1.0], "load": [1.0, 1.0, 1.0]}
    => values of parameters must be numbers or arrays of one length, got shapes [(2,), (3,)].
{"mass": np.ones((2, 2))} => values of parameters must be numbers or arrays of one length
> save_singular_values({}) => AnalysisError:
tmp_path / "f.png", mode() => model 'mode': without inputs or outputs there are no singular values
tmp_path / "f.abc", model => f.abc: the figure cannot be written: … abc
tmp_path / "none" / "f.png", model
    => none/f.png: the figure cannot be written: … none is not a folder.
(tmp_path / "d.png").mkdir() or tmp_path / "d.png", model
    => d.png: the figure cannot be written: … Is a directory
"""
)


def mode() -> mbdlft.LFTModel:
    """A mode alone, without inputs and outputs."""
    bending = mbdlft.Mode(frequency=3.0, damping=0.01, participation=(0, 0, 0.1, 0, 0, 0))
    inertia = Inertia(xx=1, yy=1, zz=1)
    mast = mbdlft.FlexibleBody(name="mast", mass=1, inertia=inertia, modes=[bending])
    return mbdlft.to_lft(kit.scene("mode", mast, kit.weld("clamp", "ground", "mast")), search=0.0)


def two_rails(low: float) -> mbdlft.Scene:
    """A mass on two rails at an angle theta: det M = m^2 sin(theta)^2."""
    along_y = {"axis": (0, 1, 0), "stiffness": 1.0}
    return kit.scene(
        "two_rails",
        mbdlft.Angle("theta", 10, low, 40),
        kit.body("a", 0.0, (0, 0, 0)),
        kit.body("b", 0.0),
        kit.point("c", 2.0),
        kit.rail("first", "ground", "a", **along_y),
        kit.weld("turn", "a", "b", (1, 0, 0), position="theta"),
        kit.rail("second", "b", "c", **along_y),
    )


def test_state_space_of_a_name_with_a_dot(model):
    assert model.at(mass=1.5).nstates == replace(model, name="cart.v2").at(mass=1.5).nstates


def test_a_figure_stays_if_a_new_one_cannot_be_written(model, tmp_path, monkeypatch):
    file = tmp_path / "figure.png"
    save_singular_values(file, model)
    before = file.read_bytes()

    def full(handle: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.fsync", full)
    with says(
        mbdlft.AnalysisError, f"{file}: the figure cannot be written: No space left", "is unchanged."
    ):
        save_singular_values(file, model)
    assert file.read_bytes() == before
    assert list(tmp_path.iterdir()) == [file]
