"""Errors of building a model and of asking a finished one: class and message."""

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

from mbdlft import (
    AnalysisError,
    Angle,
    Fixed,
    FlexibleBody,
    Mode,
    Parameter,
    PointMass,
    Prismatic,
    RigidBody,
    Scene,
    SceneError,
    StructureError,
    TrimError,
    WellPosednessError,
    assemble,
    corners,
    frequency_response,
    grid,
    matrices_at,
    random,
    realize,
    scene_from_toml,
    solve_trim,
    to_lft,
    trim_at,
)
from mbdlft.multibody.body import Inertia
from mbdlft.problem.linearization import relinearize
from mbdlft.problem.relations import trim_relations
from mbdlft.show import save_singular_values
from tests.errors.scenes import ARM, cart, says

MASSES = [Parameter("mass", 1, 0.5, 2, unit="kg"), Parameter("load", 1, 0.5, 2, unit="kg")]


@pytest.fixture(scope="module")
def model():
    return to_lft(cart("mass + load", MASSES), search=0.0)


@pytest.fixture(scope="module")
def equations():
    return assemble(cart("mass + load", MASSES, gravity=(0, -9.81, 0)))


# the mass matrix over the range -------------------------------------------------------------------


def test_mass_that_vanishes_at_a_corner():
    with says(
        WellPosednessError,
        "scene 'cart_on_rail': the model is singular at m = 0 kg: the determinant of its equations "
        "vanishes there. Narrow the ranges, or keep masses and inertias away from zero.",
    ):
        to_lft(cart("m", [Parameter("m", 1, 0, 2, unit="kg")]), search=0.0)
    to_lft(cart("m", [Parameter("m", 1, 0.01, 2, unit="kg")]), search=0.0)


def test_mass_that_vanishes_inside_the_range():
    with says(WellPosednessError, "scene 'cart_on_rail'", "singular"):
        to_lft(cart("mass*(r - 0.7)^2", [MASSES[0], Parameter("r", 0.5, 0.1, 0.9)]), search=0.0)


def two_rails(low: float) -> Scene:
    """A mass on two rails at an angle theta: det M = m^2 sin(theta)^2."""
    along_y = {"axis": (0, 1, 0), "stiffness": 1.0}
    return Scene(
        name="two_rails",
        parameters=[Angle("theta", 10, low, 40)],
        bodies=[
            RigidBody(name="a", mass=0.0, inertia=Inertia(xx=0, yy=0, zz=0)),
            RigidBody(name="b", mass=0.0),
            PointMass(name="c", mass=2.0),
        ],
        joints=[
            Prismatic(name="first", parent="ground", child="a", **along_y),
            Fixed(name="turn", parent="a", child="b", axis=(1, 0, 0), position="theta"),
            Prismatic(name="second", parent="b", child="c", **along_y),
        ],
    )


def test_mass_matrix_that_is_singular_at_an_angle_inside_the_range():
    to_lft(two_rails(5), search=0.0)
    with says(WellPosednessError, "scene 'two_rails'", "singular"):
        to_lft(two_rails(-30), search=0.0)


@pytest.mark.filterwarnings("ignore:.*not proved.*:mbdlft.MbdlftWarning")
@pytest.mark.parametrize("mass", [0.0, "0*mass"])
def test_mass_matrix_that_is_singular_at_nominal_names_the_scene(mass):
    with says(WellPosednessError, "scene 'cart_on_rail'", "mass"):
        to_lft(cart(mass, MASSES), search=0.0)


def test_accelerations_that_cannot_be_solved_for():
    equations = assemble(cart("m", [Parameter("m", 1, 0, 2, unit="kg")]))
    with says(
        WellPosednessError,
        "scene 'cart_on_rail': the mass matrix is singular at a point of the parameter range: nothing "
        "with enough inertia moves with rail.velocity. Keep masses and inertias away from zero",
    ):
        relinearize(equations, [0], [0], np.array([[1.0], [0.0]]))


# trim ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"mas": 1.0}, "trim: unknown parameter 'mas'. Did you mean 'mass'? Existing: load, mass."),
        ({"mass": 3.0}, "trim: mass = 3 is outside its range [0.5, 2] kg."),
        ({"mass": np.nan}, "trim: mass = nan is outside its range [0.5, 2] kg."),
    ],
)
def test_trim_values(equations, values, message):
    with says(TrimError, message):
        solve_trim(equations, values)


def test_trim_with_an_effort_that_does_nothing(equations):
    residual = ca.substitute(equations.residual, equations.u, 0)
    with says(
        TrimError,
        "scene 'cart_on_rail': the equilibrium does not determine the trim unknowns rail.force: they "
        "are redundant, 1 too many. Give a value to that many of them",
    ):
        solve_trim(replace(equations, residual=residual))
    with says(TrimError, "scene 'cart_on_rail': the equilibrium does not determine"):
        trim_relations(replace(equations, residual=residual))


def test_trim_with_redundant_efforts():
    arm = assemble(scene_from_toml(ARM))
    both = arm.u[0] + arm.u[1]
    residual = ca.substitute(arm.residual, arm.u, ca.vertcat(both, both))
    with says(
        TrimError,
        "scene 'two_link_arm': the equilibrium does not determine the trim unknowns shoulder.torque, "
        "elbow.torque: they are redundant, 1 too many.",
    ):
        solve_trim(replace(arm, residual=residual))


def test_trim_that_does_not_exist(equations):
    passive = replace(equations, unknown=(), given=ca.SX([2.5]))
    with says(
        TrimError,
        "scene 'cart_on_rail': no equilibrium at load = 1 kg, mass = 1 kg: rail.force misses ",
        " N, and nothing is unknown. Leave out a preload or a load's magnitude that can balance it,",
    ):
        solve_trim(passive)


# a finished model ---------------------------------------------------------------------------------


def test_model_with_other_parameters_or_signals(model):
    with says(
        StructureError,
        "model 'cart_on_rail': the blocks ['load', 'mass'] are not the parameters ['load'].",
    ):
        replace(model, parameters=model.parameters[:1])
    with says(
        StructureError,
        "model 'cart_on_rail': the signals need shape (3, 2), the LFT has (3, 3).",
    ):
        replace(model, inputs=())


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"mas": 1.0}, "unknown parameter 'mas'. Did you mean 'mass'? Existing: load, mass."),
        (
            {"mass": 3.0},
            "mass = 3 is outside its range [0.5, 2] kg. Widen the range in the scene and linearize "
            "again.",
        ),
        ({"mass": [1.0, 0.4]}, "mass = 0.4 is outside its range [0.5, 2] kg."),
        ({"mass": np.nan}, "mass = nan is outside its range"),
        (
            {"mass": [1.0, 1.0], "load": [1.0, 1.0, 1.0]},
            "values of parameters must be numbers or arrays of one length, got shapes [(2,), (3,)].",
        ),
        ({"mass": np.ones((2, 2))}, "values of parameters must be numbers or arrays of one length"),
    ],
)
def test_values_of_parameters(model, values, message):
    for ask in (matrices_at, trim_at):
        with says(StructureError, f"model 'cart_on_rail': {message}"):
            ask(model, values)


def test_array_of_two_dimensions_is_told_from_arrays_of_two_lengths(model):
    with says(StructureError, "(2, 2)"):
        matrices_at(model, {"mass": np.ones((2, 2))})


def test_state_space_at_a_value_outside(model):
    with says(
        StructureError, "model 'cart_on_rail': unknown parameter 'mas'. Did you mean 'mass'?"
    ):
        model.at(mas=1.0)


def test_state_space_of_a_name_with_a_dot(model):
    assert model.at(mass=1.5).nstates == replace(model, name="cart.v2").at(mass=1.5).nstates


def test_trim_that_was_not_stored(model):
    without = replace(model, trim=replace(model.trim, lft=None))
    with says(StructureError, "model 'cart_on_rail' was stored without the LFT of its trim."):
        trim_at(without, {})


def test_frequency_that_is_a_pole():
    free = to_lft(cart("mass + load", MASSES, joint={"stiffness": 0.0}), search=0.0)
    with says(
        AnalysisError,
        "model 'cart_on_rail': omega = 0 rad/s is a pole at one of the samples, where the response "
        "is infinite. Leave this frequency out or add damping.",
    ):
        frequency_response(free, {}, [1.0, 0.0])


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: grid(MASSES, {"mas": 2}), "grid: unknown parameter 'mas'. Did you mean 'mass'?"),
        (
            lambda: grid(MASSES, {"mass": 0}),
            "grid: counts must be whole numbers of at least 1, got {'mass': 0}.",
        ),
        (
            lambda: grid(MASSES, {"mass": 2.5}),
            "grid: counts must be whole numbers of at least 1, got {'mass': 2.5}.",
        ),
        (
            lambda: random(MASSES, -3),
            "random: expected a number of points such as 1000, got -3.",
        ),
        (
            lambda: random(7, 3),
            "random: expected parameters, such as model.parameters, got int.",
        ),
        (
            lambda: corners("mass"),
            "corners: expected parameters, such as model.parameters, got str.",
        ),
        (
            lambda: grid(MASSES, {"mass": 10**4, "load": 10**4}),
            "grid: 1e+08 points are more than 4194304; use random points.",
        ),
        (
            lambda: corners([Parameter(f"p{k}", 1, percent=10) for k in range(23)]),
            "grid: 8.39e+06 points are more than 4194304; use random points.",
        ),
    ],
)
def test_samples(make, message):
    with says(AnalysisError, message):
        make()


@pytest.mark.parametrize("omega", [float("nan"), [1.0, float("inf")], ["fast"], 1j])
def test_frequencies_that_are_none(model, omega):
    with says(
        AnalysisError,
        f"model 'cart_on_rail': omega: expected finite frequencies (rad/s), got {omega!r}.",
    ):
        frequency_response(model, {}, omega)


def test_values_without_names(model):
    with says(
        StructureError,
        "model 'cart_on_rail': expected values by name, such as {'load': 1.0}, got [1.0].",
    ):
        matrices_at(model, [1.0])


@pytest.mark.parametrize("search", [-1.0, float("nan"), "long"])
def test_search_that_is_no_time(search):
    message = f"search: expected units of work, 0 for no search, got {search!r}."
    with says(SceneError, message):
        to_lft(cart("mass + load", MASSES), search=search)
    with says(SceneError, message):
        realize([["1"]], [], search=search)


def test_figure_of_a_model_without_inputs(tmp_path):
    clamp = Fixed(name="clamp", parent="ground", child="mast")
    mode = Mode(frequency=3.0, damping=0.01, participation=(0, 0, 0.1, 0, 0, 0))
    inertia = Inertia(xx=1, yy=1, zz=1)
    mast = FlexibleBody(name="mast", mass=1, inertia=inertia, modes=[mode])
    alone = to_lft(Scene(name="mode", bodies=[mast], joints=[clamp]), search=0.0)
    with says(
        AnalysisError, "model 'mode': without inputs or outputs there are no singular values"
    ):
        save_singular_values(tmp_path / "figure.png", alone)
    assert not (tmp_path / "figure.png").exists()


def test_figure_that_cannot_be_written(model, tmp_path):
    file = tmp_path / "figure.abc"
    with says(AnalysisError, f"{file}: the figure cannot be written: ", "abc"):
        save_singular_values(file, model)
    file = tmp_path / "none" / "figure.png"
    with says(
        AnalysisError, f"{file}: the figure cannot be written: {file.parent} is not a folder."
    ):
        save_singular_values(file, model)
    folder = tmp_path / "folder.png"
    folder.mkdir()
    with says(AnalysisError, f"{folder}: the figure cannot be written: ", "Is a directory"):
        save_singular_values(folder, model)
