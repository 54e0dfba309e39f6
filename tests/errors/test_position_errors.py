"""Errors of equilibria: what cannot be unknown, does not exist, or cannot be fitted."""

from typing import Any

import numpy as np

import mbdlft
from tests import kit
from tests.errors.table import refused, says
from tests.laws.test_couplings import TANGENT, arm
from tests.laws.test_equilibrium import cable, chain, four_bar, pendulum


def faller(**fields: Any) -> mbdlft.Scene:
    """A mass on a vertical slide that nothing holds."""
    slide = kit.rail("slide", "ground", "bob", (0, 0, 1), preload=0.0, **fields)
    return kit.scene("faller", kit.point("bob", 2.0), slide, gravity=(0, 0, -9.81))


def ball(stiffness: float) -> mbdlft.Scene:
    """A point mass on a rod, on a ball joint with springs."""
    joint = kit.ball("ball", "ground", "bob.top", preload=(0.0,) * 3, stiffness=(stiffness,) * 3)
    bob = kit.point("bob", 1.0, ports={"top": (0, 0, 1)})
    return kit.scene("ball", bob, joint, gravity=(0, 0, -9.81))


def column(*parameters: mbdlft.Parameter, stiffness: float | str = "k", **fields: Any) -> mbdlft.Scene:
    """A mass on top of a rod with a spring at its foot: k theta = m g sin(theta), critical at k = m g."""
    return kit.scene(
        "column",
        *(parameters or [mbdlft.Parameter("k", 25.0, low=15.0, high=30.0, unit="N m/rad")]),
        kit.point("bob", 2.0, ports={"foot": (0, 0, -1)}),
        kit.hinge(
            "foot", "ground", "bob.foot", (1, 0, 0), **{"preload": 0.0, "stiffness": stiffness, **fields}
        ),
        gravity=(0, 0, -9.81),
    )


def level(mass: float) -> mbdlft.Scene:
    """The pendulum without a spring, held horizontally by the torque that a mass (kg) needs."""
    return pendulum(position=float(np.pi / 2), stiffness=0.0, preload=mass * 9.81 * 0.8)


test_messages = refused(
    r"""
> {} => TrimError:
# Which direction is not balanced, by how much, and that no position changes that.
find_equilibrium(faller(), starts=4)
    => scene 'faller': no equilibrium found from 4 starts with the unknown positions slide.position. …
        slide.force misses 19.62 N; there no small change of the unknowns makes that smaller. Use more
# m g L = 15.7 N m at most: 4.3 N m are left at the best angle.
find_equilibrium(pendulum(stiffness=0.0, preload=20.0), starts=3)
    => hinge.angle = 1.57 … hinge.torque misses -4.304 N m … no small change
find_equilibrium(pendulum(preload=None, stiffness=0.0, imposed=True), positions=['hinge'])
    => joint 'hinge' is imposed, so its position is given. Leave it out.
find_equilibrium(cable(rest_length=0.45).model_copy(update={'bodies':
    (cable(rest_length=0.45).bodies[0], mbdlft.Ground(ports={'hook': (0, 0, -0.4)}))}), starts=1)
    => the equations are not finite at any of 1 start. A spring whose ports
find_equilibrium(four_bar().model_copy(update={'bodies': (*four_bar().bodies[:3],
    mbdlft.Ground(ports={'hook': (0, 9.0, 0)}))}), starts=2)
    => no equilibrium found from 2 starts … close.gap. … misses
at_equilibrium(chain(1), find_equilibrium(pendulum()))
    => scene 'chain': the equilibrium is one of the scene 'pendulum' with hinge
at_equilibrium(column(), find_equilibrium(pendulum()))
    => scene 'column': the equilibrium is one of the scene 'pendulum' with hinge
at_equilibrium(level(1.2), find_equilibrium(level(1.2), positions=['m']))
    => parameter 'm' was found at 1.2 kg, an end of its range
# The column buckles at k = 2 * 9.81.
fit_positions(column(), ["foot"], 1e-4) => scene 'column', fit of foot: … near k = 19.6 … bifurcates
# A torque tau = m g sin(theta) has no equilibrium above 19.62 N m.
fit_positions(column(Parameter('tau', 10.0, low=5.0, high=25.0, unit='N m'), stiffness=0.0,
    preload='-tau'), ['foot'], 0.0001)
    => scene 'column', fit of foot: … near tau = 19.6 … folds
fit_positions(column(position=0.4, stiffness="k + 8"), ["foot"], 1e-15)
    => scene 'column', fit of foot: … tolerance
fit_positions(pendulum(orientation=(kit.turn((0, 1, 0), 'psi'),)).model_copy(update={'parameters':
    (*pendulum().parameters, Angle('psi', 10, 0, 20))}), ['hinge'], 0.0001)
    => NotRationalError: the equilibrium depends on the angle 'psi'
fit_positions(faller(position='z', stiffness=50.0).model_copy(update={'parameters': (Parameter('z', 0.2,
    low=0.1, high=0.4, unit='m'),)}), ['slide'], 0.0001)
    => the spring of 'slide' is relaxed at a position that depends on parameters
# The torque is just as large as gravity's can be.
fit_positions(level(2.0), ["hinge"], 1e-4)
    => does not determine hinge.angle: it is a fold or a bifurcation
mbdlft.assemble(chain(1).model_copy(update={'fit': Fit(tolerance=0.001, bounds={'j9.angle': 0.001})}))
    => SceneError: fit: unknown coordinate or effort 'j9.angle'. Did you mean 'j0.angle'?
Fit(tolerance=1e-3, bounds={"j0.angle": -1.0})
    => SceneError: fit: j0.angle: expected a number that is not negative, got -1.
mbdlft.scene_from_toml("fit = 3\n" + mbdlft.scene_to_toml(chain(1)))
    => SceneError: fit: expected a table, got 3.
mbdlft.assemble(faller(stiffness='100*atan(m/m)').model_copy(update={'parameters': (Parameter('m', 2.0,
    percent=10),)}))
    => NotRationalError: atan takes constants only; an angle may have 2*atan of parameters.
> find_equilibrium(pendulum(), {}) => TrimError:
values={"M": 2.0} => scene 'pendulum': unknown parameter 'M'. Did you mean 'm'?
values={"m": 9.0} => m = 9 is outside its range [1.2, 2.8] kg.
positions=["hing"] => positions: unknown joint, coordinate or parameter 'hing'. Did you mean 'hinge'?
bounds={"m": (1.0, 2.0)} => bounds: unknown unknown … 'm' … hinge.angle
bounds={"hinge": (2.0, 1.0)} => bounds of hinge: expected low < high, got 2, 1.
starts=0 => starts: expected at least 1, got 0.
bounds={"hinge": (2.0, 2.5)}, starts=3
    => from 3 starts … hinge.torque misses … hinge.angle at the end of the bounds.
> (lambda scene, joints: fit_positions(scene, joints, 1e-4))({}) => TrimError:
pendulum(), ["hing"] => scene 'pendulum', fit of hing: … unknown joint 'hing'. Did you mean 'hinge'?
pendulum(preload=None), ["hinge"]
    => scene 'pendulum', fit of hinge: … 'hinge' has no preload, so its effort holds it.
ball(0.0), ["ball"] => scene 'ball', fit of ball: … 'ball' turns about all axes.
chain(1), ["j0"]
    => scene 'chain', fit of j0: … these positions do not depend on parameters. at_equilibrium(
pendulum().model_copy(update={"fit": Fit(tolerance=1e-3, bounds={})}), ["hinge"]
    => scene 'pendulum', fit of hinge: … its positions are a fit already.
chain(1).model_copy(update={"gravity": (0, 0, 0)}), ["j0"]
    => scene 'chain', fit of j0: … the nominal equilibrium does not determine j0.angle: it is
> mbdlft.assemble(arm({}, [TANGENT, Angle('psi', 10, 0, 20)])) => NotRationalError: joint 'hinge',
    position …
"atan(t)" => 1 times atan(t); only even multiples of atan
"3*atan(t)" => 3 times atan(t) … Write 2*atan(r)
"0.5*atan(t)" => multiplied by an integer only
"2*atan(t)^2" => multiplied by an integer only
"40*atan(t)" => SceneError: 40 times atan(t) … 16 is the most.
"2*t" => SceneError: 't' is not an angle. … 2*atan(r).
"2*atan(m)" => SceneError: atan = 'm': the unit does not fit: expected 1, got kg.
"2*atan(1/t)" => WellPosednessError: atan: the denominator t vanishes in the range
"2*atan(psi)" => atan of the angle 'psi'.
"2*atan(x)" => SceneError: unknown name 'x'
"""
)


def test_ball_with_springs_and_bounds() -> None:
    with says(mbdlft.TrimError, "joint 'ball' has a stiffness against rotations about all axes"):
        mbdlft.find_equilibrium(ball(5.0), positions=["ball"])
    assert mbdlft.find_equilibrium(ball(5.0)).positions == {}
    with says(mbdlft.TrimError, "bounds: a rotation vector such as ball.rotation.x has none."):
        mbdlft.find_equilibrium(ball(0.0), bounds={"ball.rotation.x": (0.0, 1.0)})


def test_loads_are_too_many_unknowns() -> None:
    """Two unknown forces for one slide: one of them is not determined, by name."""
    loads = [kit.force(name, "bob", (0, 0, 1), frame="ground") for name in ("a", "b")]
    point = mbdlft.find_equilibrium(faller().model_copy(update={"loads": tuple(loads)}))
    assert set(point.undetermined) == {"slide.position", "a.force", "b.force"}


def test_unused_spring_keeps_its_rest_length() -> None:
    """A spring with no stiffness and no force density does nothing."""
    spring = kit.spring("s", "ground", "bob", stiffness=0.0, force_density=0.0)
    scene = faller(position=-1.0, stiffness=30.0).model_copy(update={"loads": (spring,)})
    moved = mbdlft.at_equilibrium(scene, mbdlft.find_equilibrium(scene))
    assert moved.loads[0] == spring
