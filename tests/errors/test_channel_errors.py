"""Errors of two-ports, inverted channels and tunable gains."""

from dataclasses import replace

import control
import pytest

import mbdlft
from mbdlft import Beam, Parameter, PointMass, WellPosednessError, invert_channels, realize, two_port
from tests.errors.table import refused

BEAM = Beam(
    name="b", length=1, density=1, area=1, modulus=1, I_y=1, I_z=1, deformations=["bending_y"], elements=1
)
K = Parameter("k", 2.0, low=1.0, high=4.0, role="design")
CART = realize([["0", "1", "0"], ["-k", "0", "1"], ["1", "0", "0"]], [K], states=2)


def static(matrix: list[list[object]], *names: str) -> mbdlft.LFTModel:
    return realize(matrix, [K], inputs=names, outputs=names)


def truncated():
    model = static([["1 + k"]], "a")
    certificate = replace(model.certificate, exact=False, truncation_error=0.01)
    return replace(model, certificate=certificate)


test_messages = refused(
    r"""
> {} => StructureError:
two_port(Ground(ports={})) => SceneError: expected a body other than the ground, got 'ground'.
two_port(BEAM, children="tip") => SceneError: children: expected a list of ports, got 'tip'.
two_port(BEAM, children=["tp"])
    => SceneError: two_port of body 'b': unknown port 'tp'. Did you mean 'tip'? Existing: origin, tip.
two_port(BEAM, children=["tip", "tip"])
    => SceneError: a port is named twice among the children tip, tip and the parent origin.
two_port(BEAM, children=["origin"], parent="tip")
    => SceneError: an elastic body is held at its origin, got the parent 'tip'. Take the two-port at the
two_port(BEAM, axes=["q"]) => SceneError: two_port of body 'b': unknown axis 'q'.
two_port(BEAM, axes=[]) => SceneError: two_port of body 'b': axes: name at least one.
invert_channels(CART, "u0") => channels: expected a list of names, got 'u0'.
invert_channels(CART, []) => model 'matrix': channels: name at least one.
invert_channels(CART, ["u"]) => unknown channel 'u'. Did you mean 'u0'?
invert_channels(CART, ["u0"])
    => channel 'u0' has 1 inputs and 0 outputs; only as many of the one as of the other
invert_channels(static([[1.0]], "a"), ["a", "a"]) => a channel is named twice in a, a.
tunable(CART, "k") => model 'matrix': names: expected a list, got 'k'.
tunable(CART, ["m"]) => model 'matrix': unknown parameter 'm'. Existing: k.
tunable(CART, ["k", "k"]) => a parameter is named twice in k, k.
tunable(realize([["a"]], [Parameter("a", 1.0, percent=10)]))
    => no parameter has the role 'design'. Name the parameters to be tuned: a.
tunable(realize([[1.0]])) => Name the parameters to be tuned: it has none.
tunable(realize([["k"]], [K], inputs=["k.w.1"]))
    => it has a signal 'k.w.1' already. Rename the parameter.
# No mode of the beam moves its tip along x.
invert_channels(two_port(BEAM), ["tip"])
    => WellPosednessError: model 'b', inversion of tip: the feed-through from its inputs to
invert_channels(static([['k - 3']], 'a'), ['a'])
    => WellPosednessError: model 'matrix', inversion of a: singular between the nominal
series(CART, "u", low_pass(1.0)) => series: unknown channel 'u'. Did you mean
series(CART, [], low_pass(1.0)) => channels: expected one or more names, each once,
series(CART, ["u0", "u0"], low_pass(1.0)) => each once, got ['u0', 'u0'].
series(CART, "u0", low_pass(1.0), side="in") => series: unknown side 'in'. Did you
series(STATIC, "a", low_pass(1.0))
    => series: a are names of inputs and of outputs. Say side = 'inputs' or 'outputs'.
series(STATIC, ["b", "c"], low_pass(1.0)) => b, c are inputs and outputs; one block
series(STATIC, ["a", "b"], low_pass(1.0), side="inputs")
    => series: the block has 1 outputs for the 2 channels a, b.
series(CART, "y0", imbalance(1.0, 0.0, 2.0)) => series: the block has 2 inputs for the 1 channels y0.
series(CART, "u0", {"gain": 1.0})
    => block: expected a System, an LFTModel, a continuous python-control system, a number or a matrix,
        got a dict.
series(CART, "u0", control.ss([[0.5]], [[1]], [[1]], [[0]], 0.1))
    => expected continuous time (dt = 0), got dt = 0.1.
series(CART, "u0", low_pass(1.0, "k", [Parameter("k", 3.0, percent=5)]))
    => the parameter 'k' of low_pass is not that of matrix:
low_pass(-3.0) => SceneError: low_pass, bandwidth = -3.0: expected a positive number, got -3
low_pass(True) => SceneError: low_pass, bandwidth = True: expected a number or an expression.
low_pass("w") => SceneError: low_pass, bandwidth = 'w': unknown name 'w'.
low_pass("T", parameters=[Parameter("T", 1.0, percent=5, unit="s")])
    => SceneError: low_pass, bandwidth = 'T': the unit does not fit: expected rad/s, got
low_pass(1.0, "z", [Parameter("z", 0.5, low=-0.1, high=1.0)], name="rw")
    => SceneError: rw, damping = 'z': expected a positive number, got -0.1 1 in the range.
delay(0.0) => SceneError: delay, time = 0.0: expected a positive number
delay(1.0, {0|2.0}) => SceneError: delay, order: expected a whole number from 1 to 20, got {0}.
band_pass(1.0, "2*", 0.7) => SceneError: band_pass, high = '2*':
imbalance(0.0, -1.0, 1.0) => SceneError: imbalance, dynamic = -1.0: expected a positive number
imbalance(0.0, 0.0, 0.0) => SceneError: imbalance, speed = 0.0: expected a positive number
assemble(Scene(name='s', parameters=[Parameter('n', 1.0, low=-1.0, high=3.0)],
    bodies=[PointMass(name='b', mass=1.0)], joints=[Revolute(name='j', parent='ground', child='b',
    axis=(0, 0, 1), gear_ratio='n')]))
    => SceneError: joint 'j': the gear_ratio vanishes in the range [-1, 3]: the actuator
> {} => StructureError: the model is truncated, and the guaranteed bound of its error holds
invert_channels(truncated(), ["a"])
tunable(truncated(), ["k"])
series(truncated(), "a", low_pass(1.0), side="inputs")
series(STATIC, "b", truncated())
"""
)


def test_a_point_mass_does_not_turn() -> None:
    """Forces at a ball can be exchanged with its accelerations, torques cannot."""
    ball = two_port(PointMass(name="ball", mass=2.0))
    once = invert_channels(ball, ["origin.acceleration.x"])
    assert once.inputs[0].name == "origin.force.x"
    assert once.D_yu[0, 0] == -0.5
    with pytest.raises(WellPosednessError):
        invert_channels(ball, ["origin"])


STATIC = realize([[2.0, 0.0], [0.0, 3.0]], inputs=["a", "b"], outputs=["a", "c"])
