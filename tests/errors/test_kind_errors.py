"""Objects of a wrong kind: every public function says which argument, what is expected, and what came."""

import importlib
import inspect
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mbdlft
from mbdlft.base import Parameter
from mbdlft.base.errors import StructureError
from mbdlft.system import LFTModel, System
from mbdlft.system.conversion import state_space
from tests.errors.scenes import cart
from tests.errors.table import refused

ONE = Parameter("one", 1.0, percent=10)
SYSTEM = state_space([[-1.0]], [[1.0]], [[1.0]], [[0.0]], name="lag")
WRONG: dict[str, Any] = {
    "Scene 'cart_on_rail'": cart(),
    "'scene.toml'": "scene.toml",
    "'arm.h5'": Path("arm.h5"),
    "dict": {"mass": 2.0},
    "StateSpace": SYSTEM.at(),
    "ndarray": np.eye(3),
    "None": None,
    "2.0": 2.0,
    "System 'lag'": SYSTEM,
    "Parameter 'one'": ONE,
}
MADE_BY = [  # of a model: what came, and what makes one of it
    ("Scene 'cart_on_rail'", "mbdlft.to_lft(scene)"),
    ("'scene.toml'", "mbdlft.load(path)"),
    ("'arm.h5'", "mbdlft.load(path)"),
    ("StateSpace", "mbdlft.as_system(item)"),
    ("ndarray", "mbdlft.as_system(item)"),
]


def _arguments() -> Iterator[tuple[Callable[..., Any], str, tuple[type, ...]]]:
    """Public functions, with names of arguments that are objects of this package, and their classes.

    They are told by the texts of annotations, which is another way than that of the package.
    """
    rooms = (*mbdlft._NAMESPACES, *mbdlft._ELSEWHERE)
    modules = [importlib.import_module(f"mbdlft.{room}") for room in rooms]
    functions = [getattr(module, name) for module in modules for name in module.__all__]
    for function in filter(inspect.isfunction, functions):
        for name, parameter in inspect.signature(function).parameters.items():
            text = inspect.formatannotation(parameter.annotation).replace(
                "~S", "mbdlft.system.model.System"
            )
            parts = [part.strip() for part in text.split("|")]
            paths = ("str", "pathlib.Path", "None")
            own = [part for part in parts if part.startswith("mbdlft.") and "array" not in part]
            if own and all(part in (*own, *paths) for part in parts):
                classes = [_class(part) for part in own]
                yield function, name, tuple(classes)


def _class(name: str) -> type:
    module, _, kind = name.rpartition(".")
    made: type = getattr(importlib.import_module(module), kind)
    return made


ARGUMENTS = list(_arguments())


def test_many_functions_take_models() -> None:
    taking = {function for function, _, classes in ARGUMENTS if {System, LFTModel} & set(classes)}
    assert len(taking) > 50
    assert {mbdlft.poles, mbdlft.matrices_at, mbdlft.casadi_function, mbdlft.export_model} <= taking


@pytest.mark.parametrize(("function", "argument", "classes"), ARGUMENTS)
def test_wrong_kinds(function: Callable[..., Any], argument: str, classes: tuple[type, ...]) -> None:
    hint = str(inspect.signature(function).parameters[argument].annotation)
    for came, value in WRONG.items():
        if isinstance(value, classes) or (value is None and "None" in hint):
            continue
        with pytest.raises(StructureError) as refusal:
            function(**{argument: value})
        message, what = str(refusal.value), f"{function.__name__}: {argument}: expected"
        assert message.startswith((f"{what} a", f"{what} the"))
        assert all(kind.__name__ in message for kind in classes)
        assert f"got {came}" in message.replace(" a ", " ").replace(" an ", " ").replace(" the ", " ")
        if classes in ((System,), (LFTModel,)):
            assert dict(MADE_BY).get(came, ".") in message


test_systems = refused(
    """
> {} => StructureError:
as_system(cart()) => expected a System, an LFTModel, a continuous python-control system, a number or a
    matrix, got the Scene 'cart_on_rail'. mbdlft.to_lft(scene) makes one of a scene.
append(SYSTEM, cart()) => append: items[1]: expected a System … got the Scene 'cart_on_rail'.
connect([SYSTEM, cart()], inputs=[], outputs=[]) => connect: systems[1]: expected … got the Scene
connect(SYSTEM, inputs=[], outputs=[])
    => connect: systems: expected a list, such as [system], got the System 'lag'.
feedback({cart()|"arm.h5"|None}) => feedback: plant: expected
feedback(SYSTEM, cart()) => feedback: controller: expected … got the Scene 'cart_on_rail'.
feedback(SYSTEM, {None|"arm.h5"}) => feedback: controller: expected
mbdlft.system.lft(cart(), SYSTEM) => lft: upper: expected … to_lft(scene)
mbdlft.system.lft(SYSTEM, cart()) => lft: lower: expected … to_lft(scene)
series(SYSTEM, cart()) => series: part 2: expected … to_lft(scene)
series(cart(), "u0", SYSTEM) => series: model: expected … to_lft(scene)
simulate(cart(), [0, 1], controller="arm.h5") => simulate: controller: expected … mbdlft.load(path)
tune(SYSTEM, [], []) => tune: systems: expected a list, such as [system], got the System 'lag'.
tune([SYSTEM], gain_goal(["u0"], ["y0"]), []) => tune: goals: expected a list of Goal, such as [goal], got
tune([SYSTEM], ["u0"], []) => tune: goals[0]: expected a Goal, got 'u0'. mbdlft.synthesis.gain_goal
tune([SYSTEM, cart()], [gain_goal(["u0"], ["y0"])], []) => tune: systems[1]: expected … to_lft(scene)
realize([["1"]], ONE) => realize: parameters: expected a list of Parameter, such as [parameter], got the
realize([["1"]], {None|"one"}) => realize: parameters: expected a list of Parameter, such as [parameter]
random([ONE, "m"], 3) => random: parameters[1]: expected a Parameter, got 'm'. model.parameters
save(SYSTEM, "arm.h5") => save: path: expected the path of a file, got the System 'lag'. The path is
corners("one") => corners: parameters: expected a list of Parameter, such as [parameter], got 'one'.
load(None) => load: path: expected the path of a file, got None.
trim_at(SYSTEM, {}) => trim_at: model: expected an LFTModel, got the System 'lag'. A system has no
"""
)
