"""Errors of two-ports, inverted channels and tunable gains."""

from collections.abc import Callable

import pytest

import mbdlft
from mbdlft import (
    Beam,
    Ground,
    Parameter,
    PointMass,
    SceneError,
    StructureError,
    WellPosednessError,
    invert_channels,
    realize,
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
