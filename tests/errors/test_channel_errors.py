"""Errors of two-ports, inverted channels and tunable gains."""

from collections.abc import Callable
from dataclasses import replace

import control
import pytest

import mbdlft
from mbdlft import (
    Beam,
    Ground,
    Parameter,
    PointMass,
    Revolute,
    Scene,
    SceneError,
    StructureError,
    WellPosednessError,
    assemble,
    band_pass,
    delay,
    imbalance,
    invert_channels,
    low_pass,
    realize,
    series,
    tunable,
    two_port,
)
from tests.errors.scenes import says

BEAM = Beam(
    name="b", length=1, density=1, area=1, modulus=1, I_z=1, deformations=["bending_y"], elements=1
)
K = Parameter("k", 2.0, low=1.0, high=4.0, role="design")
CART = realize([["0", "1", "0"], ["-k", "0", "1"], ["1", "0", "0"]], [K], states=2)


def static(matrix: list[list[object]], *names: str) -> mbdlft.LFTModel:
    return realize(matrix, [K], inputs=names, outputs=names)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: two_port(Ground(ports={})), "expected a body other than the ground, got the kind"),
        (lambda: two_port("b"), "two_port: expected a body other than the ground, got str."),
        (lambda: two_port(BEAM, children="tip"), "children: expected a list of ports, got 'tip'."),
        (
            lambda: two_port(BEAM, children=["tp"]),
            "two_port of body 'b': unknown port 'tp'. Did you mean 'tip'? Existing: origin, tip.",
        ),
        (
            lambda: two_port(BEAM, children=["tip", "tip"]),
            "a port is named twice among the children tip, tip and the parent origin.",
        ),
        (
            lambda: two_port(BEAM, children=["origin"], parent="tip"),
            "an elastic body is held at its origin, got the parent 'tip'. Take the two-port at the",
        ),
        (lambda: two_port(BEAM, axes=["q"]), "two_port of body 'b': unknown axis 'q'."),
        (lambda: two_port(BEAM, axes=[]), "two_port of body 'b': axes: name at least one."),
    ],
)
def test_two_port(make: Callable[[], object], message: str) -> None:
    with says(SceneError, message):
        make()


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: invert_channels(CART, "u0"), "channels: expected a list of names, got 'u0'."),
        (lambda: invert_channels(CART, []), "model 'matrix': channels: name at least one."),
        (lambda: invert_channels(CART, ["u"]), "unknown channel 'u'. Did you mean 'u0'?"),
        (
            lambda: invert_channels(CART, ["u0"]),
            "channel 'u0' has 1 inputs and 0 outputs; only as many of the one as of the other",
        ),
        (
            lambda: invert_channels(static([[1.0]], "a"), ["a", "a"]),
            "a channel is named twice in a, a.",
        ),
        (lambda: tunable(CART, "k"), "model 'matrix': names: expected a list, got 'k'."),
        (lambda: tunable(CART, ["m"]), "model 'matrix': unknown parameter 'm'. Existing: k."),
        (lambda: tunable(CART, ["k", "k"]), "a parameter is named twice in k, k."),
        (
            lambda: tunable(realize([["a"]], [Parameter("a", 1.0, percent=10)])),
            "no parameter has the role 'design'. Name the parameters to be tuned: a.",
        ),
        (lambda: tunable(realize([[1.0]])), "Name the parameters to be tuned: it has none."),
        (
            lambda: tunable(realize([["k"]], [K], inputs=["k.w.1"])),
            "it has a signal 'k.w.1' already. Rename the parameter.",
        ),
    ],
)
def test_structure(make: Callable[[], object], message: str) -> None:
    with says(StructureError, message):
        make()


def test_singular_at_nominal() -> None:
    """No mode of the beam moves its tip along x."""
    with says(
        WellPosednessError,
        "model 'b', inversion of tip: the feed-through from its inputs to",
    ):
        invert_channels(two_port(BEAM), ["tip"])


def test_singular_in_the_range() -> None:
    model = static([["k - 3"]], "a")
    with says(
        WellPosednessError,
        "model 'matrix', inversion of a: singular between the nominal",
    ):
        invert_channels(model, ["a"])


def test_a_point_mass_does_not_turn() -> None:
    """Forces at a ball can be exchanged with its accelerations, torques cannot."""
    ball = two_port(PointMass(name="ball", mass=2.0))
    once = invert_channels(ball, ["origin.acceleration.x"])
    assert once.inputs[0].name == "origin.force.x"
    assert once.D_yu[0, 0] == -0.5
    with pytest.raises(WellPosednessError):
        invert_channels(ball, ["origin"])


STATIC = realize([[2.0, 0.0], [0.0, 3.0]], inputs=["a", "b"], outputs=["a", "c"])


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: series(CART, "u", low_pass(1.0)), "series: unknown channel 'u'. Did you mean"),
        (
            lambda: series(CART, [], low_pass(1.0)),
            "channels: expected one or more names, each once,",
        ),
        (lambda: series(CART, ["u0", "u0"], low_pass(1.0)), "each once, got ['u0', 'u0']."),
        (
            lambda: series(CART, "u0", low_pass(1.0), side="in"),
            "series: unknown side 'in'. Did you",
        ),
        (
            lambda: series(STATIC, "a", low_pass(1.0)),
            "series: a are names of inputs and of outputs. Say side = 'inputs' or 'outputs'.",
        ),
        (
            lambda: series(STATIC, ["b", "c"], low_pass(1.0)),
            "b, c are inputs and outputs; one block",
        ),
        (
            lambda: series(STATIC, ["a", "b"], low_pass(1.0), side="inputs"),
            "series: the block has 1 outputs for the 2 channels a, b.",
        ),
        (
            lambda: series(CART, "y0", imbalance(1.0, 0.0, 2.0)),
            "series: the block has 2 inputs for the 1 channels y0.",
        ),
        (
            lambda: series(CART, "u0", {"gain": 1.0}),
            "block: expected a System, an LFTModel, a continuous python-control system, a number or a "
            "matrix, got dict.",
        ),
        (
            lambda: series(CART, "u0", control.ss([[0.5]], [[1]], [[1]], [[0]], 0.1)),
            "expected continuous time (dt = 0), got dt = 0.1.",
        ),
        (
            lambda: series(CART, "u0", low_pass(1.0, "k", [Parameter("k", 3.0, percent=5)])),
            "the parameter 'k' of low_pass is not that of matrix:",
        ),
    ],
)
def test_series(make: Callable[[], object], message: str) -> None:
    with says(StructureError, message):
        make()


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: low_pass(-3.0), "low_pass, bandwidth = -3.0: expected a positive number, got -3"),
        (lambda: low_pass(True), "low_pass, bandwidth = True: expected a number or an expression."),
        (lambda: low_pass("w"), "low_pass, bandwidth = 'w': unknown name 'w'."),
        (
            lambda: low_pass("T", parameters=[Parameter("T", 1.0, percent=5, unit="s")]),
            "low_pass, bandwidth = 'T': the unit does not fit: expected rad/s, got",
        ),
        (
            lambda: low_pass(1.0, "z", [Parameter("z", 0.5, low=-0.1, high=1.0)], name="rw"),
            "rw, damping = 'z': expected a positive number, got -0.1 1 in the range.",
        ),
        (lambda: delay(0.0), "delay, time = 0.0: expected a positive number"),
        (lambda: delay(1.0, 0), "delay, order: expected a whole number from 1 to 20, got 0."),
        (lambda: delay(1.0, 2.0), "delay, order: expected a whole number from 1 to 20, got 2.0."),
        (lambda: band_pass(1.0, "2*", 0.7), "band_pass, high = '2*': "),
        (
            lambda: imbalance(0.0, -1.0, 1.0),
            "imbalance, dynamic = -1.0: expected a positive number",
        ),
        (lambda: imbalance(0.0, 0.0, 0.0), "imbalance, speed = 0.0: expected a positive number"),
    ],
)
def test_actuators(make: Callable[[], object], message: str) -> None:
    with says(SceneError, message):
        make()


def test_a_gear_that_does_not_turn() -> None:
    n = Parameter("n", 1.0, low=-1.0, high=3.0)
    joint = Revolute(name="j", parent="ground", child="b", axis=(0, 0, 1), gear_ratio="n")
    scene = Scene(name="s", parameters=[n], bodies=[PointMass(name="b", mass=1.0)], joints=[joint])
    with says(SceneError, "joint 'j': the gear_ratio vanishes in the range [-1, 3]: the actuator"):
        assemble(scene)


@pytest.mark.parametrize(
    "make",
    [
        lambda model: invert_channels(model, ["a"]),
        lambda model: tunable(model, ["k"]),
        lambda model: series(model, "a", low_pass(1.0), side="inputs"),
        lambda model: series(STATIC, "b", model),
    ],
)
def test_a_guaranteed_error_is_not_carried_over(make: Callable[[object], object]) -> None:
    model = static([["1 + k"]], "a")
    certificate = replace(model.certificate, exact=False, truncation_error=0.01)
    with says(
        StructureError, "the model is truncated, and the guaranteed bound of its error holds"
    ):
        make(replace(model, certificate=certificate))
