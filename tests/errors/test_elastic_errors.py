"""What is said about elastic bodies that are wrong, incomplete or out of scope."""

from typing import Any

import numpy as np

import mbdlft
from mbdlft import Beam, Fixed, FlexibleBody, Inertia, Mode, Revolute, Scene
from mbdlft.multibody.body import Body
from tests import kit
from tests.errors.table import refused, says
from tests.laws import elastic as scenes

SIX = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


def mode(**given: Any) -> Mode:
    data: dict[str, Any] = {"frequency": 3.0, "participation": SIX, "shapes": {"tip": SIX}}
    return Mode(**{**data, **given})


def panel(**given: Any) -> FlexibleBody:
    data: dict[str, Any] = {
        "mass": 3.0,
        "inertia": Inertia(xx=1.0, yy=1.0, zz=1.0),
        "ports": {"tip": (1, 0, 0)},
        "modes": (mode(),),
    }
    return FlexibleBody(**{**{"name": "panel"}, **data, **given})


def on_hinge(body: Body, **fields: Any) -> Scene:
    hinge = kit.hinge("hinge", "ground", body.name, (0, 0, 1))
    return Scene(**{"name": "held", "bodies": [body], "joints": [hinge], **fields})


def build(scene: Scene) -> mbdlft.LFTModel:
    return mbdlft.to_lft(scene, search=0.0)


def with_a_beam(name: str, unit: str) -> mbdlft.LFTModel:
    value = mbdlft.Parameter("value", 1.0, low=-0.5, high=2.0, unit=unit)
    return build(on_hinge(scenes.beam(**{name: "value"}), parameters=[value]))


def twisted(**given: Any) -> Scene:
    """A beam under its weight that bends in two planes and twists."""
    three = ("torsion", "bending_y", "bending_z")
    body = scenes.beam(deformations=three, shear_modulus=1e3, torsion_constant=1.0, **given)
    return on_hinge(body, gravity=(-1.0, 0.0, -9.81))


def test_load_across_a_beam_that_twists_must_be_said_to_be_known() -> None:
    with says(
        mbdlft.TrimError,
        "body 'beam' is elastic and carries a load",
        "prestress = 'neglected'",
        "prestress = 'axial'",
    ):
        build(twisted())
    stiffness = {word: scenes.motion(twisted(prestress=word)).K for word in ("neglected", "axial")}
    assert np.max(np.abs(stiffness["axial"] - stiffness["neglected"])) > 0.1
    weightless = twisted().model_copy(update={"gravity": (0, 0, 0)})
    assert build(weightless).certificate.exact


def test_load_on_modes_must_be_said_to_be_known() -> None:
    heavy = on_hinge(panel(), gravity=(0, 0, -9.81))
    with says(mbdlft.TrimError, "body 'panel' is elastic and carries a load"):
        build(heavy)
    assert build(on_hinge(panel(prestress="neglected"), gravity=(0, 0, -9.81))).certificate.exact


def test_load_on_a_beam_in_one_plane_is_known() -> None:
    assert build(scenes.lever(20.0, prestress=None)).certificate.exact


test_messages = refused(
    r"""
scenes.beam(prestress="included") => prestress: expected 'neglected', 'axial' or nothing, got 'included'
panel(prestress="axial") => prestress: expected 'neglected' or nothing, got 'axial'
scenes.beam(shear_coefficient=0.8, shear_modulus=1.0, modes=4)
    => modes: the modes of a beam with a shear_coefficient … `elements`
scenes.beam(modes=41) => modes … 41
Beam(name="b", length=1, density=1, area=1, elements=4, modes=8, modulus=1, deformations=["axial"])
    => body 'b': got elements = 4 and modes = 8, in the place of elements …
    Leave one of both out; elements are 1 to 200, and modes 1 to 40.
panel(modes=()) => modes: at least one is needed
panel(modes=(mode(shapes={}),)) => mode 1 has no shape at the port 'tip' … shapes.tip
panel(modes=(mode(), mode(shapes={"tip": SIX, "end": SIX})))
    => mode 2 has a shape at 'end', which is not a port
panel(inertia=Inertia(zz=1.0, about="end")) => inertia.about: unknown port 'end'
with_a_beam("length", "m") => body 'beam' … length is not positive in the range
with_a_beam("density", "kg m^-3") => body 'beam' … density is not positive in the range
with_a_beam("area", "m^2") => body 'beam' … area is not positive in the range
with_a_beam("modulus", "Pa") => body 'beam' … modulus is not positive in the range
with_a_beam("I_y", "m^4") => body 'beam' … I_y is not positive in the range
build(on_hinge(scenes.beam(length='value'), parameters=[mbdlft.Parameter('value', 1.0, percent=10,
    unit='kg')]))
    => body 'beam', length = 'value': the unit does not fit: expected m, got kg
build(on_hinge(scenes.beam()).model_copy(update={'bodies': (*on_hinge(scenes.beam()).bodies,
    PointMass(name='bob', mass=1.0)), 'joints': (*on_hinge(scenes.beam()).joints, Fixed(name='end',
    parent='beam.end', child='bob'))}))
    => joint 'end', parent … body 'beam' … end … tip
> (lambda child, body: build(on_hinge(body).model_copy(update={'joints':
    (on_hinge(body).joints[0].model_copy(update={'child': child}),)})))({}) => SceneError: joint
    'hinge', child: an elastic body is held at its origin …
"beam.tip", scenes.beam() => beam.tip
"panel.tip", panel() => panel.tip
> build(on_hinge({}, spin=mbdlft.Spin(axis=(0, 0, 1), rate=1.0))) => SceneError:
panel() => the frame spins and body 'panel' is elastic … without torsion
scenes.beam(rotary_inertia=True) => the frame spins and body 'beam' is elastic … without torsion
scenes.beam(deformations=("torsion",), shear_modulus=1.0, torsion_constant=1.0, I_y=1.0, I_z=1.0)
    => the frame spins and body 'beam' is elastic … without torsion
scenes.beam() => accepted
> build(on_hinge(panel(modes=(mode({}),)))) => SceneError: body 'panel' …
participation=(0.0, 1.8, 0.0, 0.0, 0.0, 0.0) => participation factors exceed the rigid mass
participation=(0.0, 1.7, 0.0, 0.0, 0.0, 0.0) => accepted
frequency=0.0
    => mode 1: the frequency is not positive in the range: 0 rad/s … stiffness is not positive definite
frequency=-3.0
    => mode 1: the frequency is not positive in the range: -3 rad/s … stiffness is not positive definite
damping=-0.1 => damping is negative
> scenes.beam({}) => SceneError:
shape_functions="linear" => shape_functions … linear … cubic
deformations=() => deformations: expected some of axial
deformations=("bending_z", "bending_z") => each once
deformations=("bend",) => deformation … bend … bending_y
deformations=("torsion",) => is missing … deformation 'torsion' needs it
I_y=None => 'I_y' is missing … bending_z
shear_coefficient=0.8, shear_modulus=1.0, shape_functions="quintic"
    => shear is for cubic shape functions only
shear_coefficient=0.8 => 'shear_modulus' is missing
ports={"end": (1, 0, 0)} => a beam has 'tip' and `stations`
stations={"far": 4} => stations.far … from 1 to 3, got 4
stations={"tip": 2} => stations.tip … a new name
"""
)


def test_rigid_redundancy_is_not_healed_by_elasticity() -> None:
    """Two rigid hinges in line hold the same; a beam somewhere else does not say how they share it."""
    scene = kit.scene(
        "door",
        kit.body("door", 1.0, (1.0, 1.0, 1.0), ports={"far": (0, 0, 1)}),
        scenes.beam(),
        mbdlft.Ground(ports={"far": (0, 0, 1)}),
        kit.hinge("near", "ground", "door", (0, 0, 1), preload=0.0),
        kit.weld("root", "door", "beam"),
        kit.loop("second", "spherical", "ground.far", "door.far"),
    )
    model = build(scene)  # the second hinge holds nothing that the first one does not
    assert not any(signal.name.startswith("second") for signal in model.trim.signals)


def test_beam_round_trips_with_its_words() -> None:
    text = mbdlft.scene_to_toml(scenes.lever(20.0))
    assert 'prestress = "neglected"' in text
    again = mbdlft.scene_from_toml(text)
    assert isinstance(again.bodies[0], Beam)
    assert mbdlft.scene_to_toml(again) == text
