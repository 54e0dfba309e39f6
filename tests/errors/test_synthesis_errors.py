"""What cannot be tuned is said with the name, the number or the pole."""

import numpy as np
import pytest

import mbdlft
from mbdlft import AnalysisError, synthesis
from mbdlft.synthesis import tuning
from mbdlft.system import state_space
from tests.errors.table import refused, says
from tests.scenarios.test_codesign import DESIGNED

PLANT = state_space([[0, 1], [0, 0]], [[0], [1]], [[1, 0]], [[0]], inputs=["f"], outputs=["y"], name="P")
BLIND = state_space(
    np.diag([2.0, -1]), [[0], [1]], [[1, 1]], [[0]], inputs=["f"], outputs=["y"], name="B"
)
# each controller has a channel that does not act on what it sees: x1 is fixed, but not for both together
CROSSED = state_space(
    np.diag([2.0, -1, -2]), [[1, 0], [0, 0], [0, 1]], [[0, 1, 0], [1, 0, 0]], np.zeros((2, 2)),
    inputs=["f", "g"], outputs=["p", "q"], name="X",
)  # fmt: skip
ALONE = synthesis.tunable_gain("K", "e", "u"), synthesis.tunable_gain("L", "d", "v")
TOGETHER = synthesis.tunable_gain("K", "e", ["u", "v"])
WIRED = (("f", "u"), ("g", "v"), ("e", "p"), ("d", "q"))
DAMPED = mbdlft.Parameter("c", 0.5, low=-0.1, high=1.1)
CORNER = mbdlft.realize(
    [["0", "1", "0"], ["-1", "-c", "1"], ["1", "0", "0"]], [DAMPED], states=2, inputs=["f"],
    outputs=["y"], search=0.0,
)  # fmt: skip
TO_PLACE = synthesis.tunable_gain("K", "e", "u")
UP_TO_TWO = synthesis.tunable_gain("K", "e", "u", ranges={"D[1,1]": (0.0, 2.0)})
# two masses, 3 and 7 kg, pushed apart and seen apart: where they are together stays at zero
PUSHED = state_space(
    np.block([[np.zeros((2, 2)), np.eye(2)], [np.outer([-1 / 3, 1 / 7], [1.1, -1.1]), np.zeros((2, 2))]]),
    [[0], [0], [1 / 3], [-1 / 7]], [[1, -1, 0, 0]], [[0]], inputs=["f"], outputs=["y"],
)  # fmt: skip
STILL = state_space([[-1.0]], [[0.0]], [[1.0]], [[0.0]], inputs=["f"], outputs=["y"])
LAG = state_space([[-1.0]], [[1.0]], [[1.0]], [[0.0]], inputs=["f"], outputs=["y"])
RATED = state_space(
    [[0, 1], [0, 0]], [[0], [1]], np.eye(2), np.zeros((2, 1)), inputs=["f"], outputs=["y", "v"]
)
TWO, FED = synthesis.tunable_gain("K", ["e", "w"], "u"), (("f", "u"), ("e", "-y"), ("w", "-v"))
FAR = {"K.D[1,1]": 1e155, "K.D[1,2]": 1e80}
PID = synthesis.tunable_pid("K", "e", "u")
SCHEDULED = mbdlft.scheduled(
    synthesis.tunable_gain("K", "e", "u"), [mbdlft.Parameter("m", 1.0, percent=10)]
)
GOAL, THROUGH = synthesis.gain_goal("f", "y"), synthesis.gain_goal("f", "p")


POLE, LOOP = synthesis.pole_goal(decay=1.0), [["f", "u"], ["e", "-y"]]
STATIC = synthesis.tunable_gain("K", "e", "u").with_values({})


def lpv(goals=(GOAL,), systems=(BLIND, PID), wired=(("f", "u"), ("e", "-y")), **how):
    return synthesis.lpv_synthesis(list(systems), list(goals), list(wired), prove=False, **how)


def made(goals=(GOAL,), systems=(PLANT, PID), wired=(("f", "u"), ("e", "-y")), **how):
    return synthesis.tune(list(systems), list(goals), list(wired), starts=1, prove=False, **how)


RULE = {"frequency": 1.0, "damping": 0.1}

test_messages = refused(
    r"""
> {} => StructureError:
made(goals=()) => expected one goal or more
made(goals=(GOAL, GOAL)) => two goals have the name 'f to y'
made(systems=(PLANT, PLANT["y", "f"])) => nothing to be tuned
made(goals=(gain_goal("g", "y"),)) => unknown input 'g'
made(goals=(gain_goal("f", "yy"),)) => unknown output 'yy'
made(wired=(("f", "u"), ("e", "-yy"))) => unknown output 'yy' … that stands in no goal is one of `inputs`
made(systems=(LAG, UP_TO_TWO), wired=(("f", "u"), ("e", "-y", "r")), inputs=("r",)) => accepted
tune([PLANT, PID], [GOAL], [], starts=0) => expected starts from 1 up, got 0
tune([PLANT, PID], [GOAL], [], starts=True) => expected starts from 1 up, got True
made(initial={"K.kp": np.nan}) => tune: initial: 'K.kp': expected a finite number, got nan.
made(initial={"K.kp": "3"}) => tune: initial: 'K.kp': expected a finite number, got '3'.
tune([PLANT, PID], [GOAL], [], seed=-1) => expected a seed from 0 up, got -1
tune([PLANT, PID], [GOAL], [], gap=np.nan) => AnalysisError: tune: gap: expected a number between 0 and 1
tune([PLANT, PID], [GOAL], [], work=-1) => AnalysisError: tune: work: expected a number between 0 and inf
made(goals=(gain_goal("f", "y", limit=1e-308),))
    => AnalysisError: goal 'f to y': it is not finite beside its limit, 1e-308.
{gain_goal([], "y")|tracking_goal([], "e", time=1.0)|margin_goal([], 0.5)}
    => one channel or more at each end
made(systems=(BLIND, PID)) => AnalysisError: the pole 2 … on the right for all of them … move 0 of it.
    Give a controller that measures or drives it (another sensor or actuator); or
made(goals=(THROUGH,), systems=(CROSSED, *ALONE), wired=WIRED) => AnalysisError: pole 2 rad/s stays
made(systems=(PUSHED, PID)) => AnalysisError: the pole 0 rad/s stays on the axis for all of them
made(goals=(THROUGH,), systems=(CROSSED, TOGETHER), wired=WIRED[:2] + (("e", "p", "q"),)) => accepted
made(systems=(PLANT, TO_PLACE)) => AnalysisError: pole 0 rad/s stays on the axis, at best … K.D[1,1] 0
made(systems=(CORNER, UP_TO_TWO)) => AnalysisError: at c -0.1: … on the right, at best … real part 0.05
made(systems=(RATED, TWO), wired=FED, initial=FAR) => AnalysisError: K.D[1,1] has come to
made(goals=(gain_goal("e", "u", norm="H2"),)) => AnalysisError: goal 'e to u': the H2 norm is infinite
gain_goal("f", "y", limit=0.0) => expected a positive limit, got 0.0
gain_goal("f", "y", limit=float("nan")) => expected a positive limit, got nan
gain_goal("f", "y", norm="inf") => expected the norm 'H-infinity' or 'H2', got 'inf'
gain_goal("f", "y", after=state_space([[0.0]], [[1]], [[1]], [[0]])) => the pole 0 … from 1/s to
gain_goal(["a", "b"], "y", before=np.eye(3)) => a weight has 3 inputs and 3 outputs, expected 1 or 2
margin_goal("f", 2.0) => expected a disk margin between 0 and 2, got 2.0
margin_goal("f") => expected a disk margin between 0 and 2, got 0.0
margin_goal("f", phase=90.0) => a phase margin from 0 to 90 deg, got 0.0 and 90.0
tracking_goal("r", "e", time=0.0) => expected a positive time, got 0.0
tracking_goal("r", "e", time=1.0, dc=2.0) => expected a peak above dc = 2.0, got 1.3
rolloff_goal("r", "u", frequency=1.0, slope=1.5) => expected a whole slope, such as 2, got 1.5
acceleration_goal("d", "a", frequency=1.0, damping=-0.1) => expected a positive damping, got -0.1
pole_goal() => one of them at least
pole_goal(damping=1.0) => a damping from 0 to 1
tunable_pid("K", "e", "u", filter=0.0) => expected a positive filter
tunable_pid("K", "e", "u", terms="PX") => unknown term 'X'
tunable_pid("K", "e", "u", initial={"kq": 1.0}) => unknown value 'kq'. Did you mean
tunable_pid("K", "e", "u", ranges={"kp": (1.0, 1.0)}) => kp: expected a finite start … low < high
tunable_pid("K", "e", "u", scale=float("nan")) => expected a finite start, a positive scale
PID.with_values({"kp": 1.0}) => unknown value 'kp'. Did you mean 'K.kp'?
mbdlft.tunable_state_space("K", "e", "u", 0) => expected an order of 1 or more
mbdlft.tunable_transfer("K", "e", "u", 0) => expected an order of 1 or more
inertia_pd("K", "q", "w", "u", inertia=0.0, **RULE) => positive inertia … and 0.0
inertia_pd("K", "q", [], "u", inertia=1.0, **RULE) => as many positions … 1, 0, 1
inertia_pd("K", "q", "w", "u", inertia=1.0, frequency=1.0, damping=0.0) => a positive damping
acceleration_feedback("K", "a", "u", mass=-1.0, **RULE) => a positive mass
acceleration_feedback("K", "a", "u", mass=1.0, **RULE, leak=1.0) => leak from 0
positive_position_feedback("K", "q", "u", mass=1.0, frequency=np.nan, damping=0.1) => frequency, got nan
integral_force_feedback("K", "F", "v", zero=1.0, **RULE) => a zero from 0 to
integral_force_feedback("K", "F", "v", frequency=2.0, zero=1.0, damping=0.6) => the largest is 0.5
design_goal("a", 0.0) => goal 'a': expected a positive limit, got 0.0
made(goals=(design_goal("2*g", 1.0), GOAL), systems=(DESIGNED,), wired=()) => parameters are: a, b
made(goals=(design_goal("a", 1.0), GOAL)) => goal 'a': … Design parameters are: none
designed_scene(mbdlft.load_scene("scenarios/pendulum.toml"), {"q": 1.0}) => unknown parameter 'q'
mbdlft.scheduled(SCHEDULED, PLANT.parameters) => expected a controller that is not scheduled
lpv() => AnalysisError: no controller was found … moves and sees every mode
lpv(systems=(PLANT,)) => one controller with free values … got 0 controllers, slack 0.03
lpv(goals=(POLE,)) => goals of the kinds H-infinity and disk margin … goal 'poles'
lpv(slack=0.0) => a slack between 0 and 1 … slack 0.0
lpv(measured=["m"]) => unknown parameter 'm'
lpv(systems=(DESIGNED, PID), wired=(("f", "u"), ("e", "y")), goals=(GOAL,)) => no design … got a, b
lpv(systems=(STILL, PID)) => u of 'K': the plant is not connected
made(wired=(("f", "u"),)) => controller 'K': nothing drives its input 'K.e'. Name it in connections
made(wired=(("e", "y"),)) => controller 'K': its output 'K.u' drives nothing
reduced_structure([PLANT, PID], [GOAL], LOOP, states=1) => of tunable_system or … got ['K'] and 1
reduced_structure([PLANT, tunable_system(STATIC)], [GOAL], LOOP, states=0) => AnalysisError: not stable
fitted_values(SCHEDULED, STATIC) => has inputs, outputs, states and parameters (1, 1, 0, ('m',))
"""
)


@pytest.mark.parametrize("search", ["stabilized", "descended"])
def test_numbers_that_overflow_in_a_search(search, monkeypatch):
    """Initial values of 1e308 were a traceback of numpy."""

    def fail(*_, **__):
        raise np.linalg.LinAlgError

    monkeypatch.setattr(tuning.Tuner, search, fail)
    with says(AnalysisError, "where the loops have no numbers any more"):
        made()
