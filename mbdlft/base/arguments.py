"""Arguments of public functions: what is no model, scene or list of goals is refused where it enters."""

import os
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from functools import wraps
from inspect import signature
from pathlib import Path
from types import UnionType
from typing import Any, NamedTuple, TypeVar, Union, cast, get_args, get_origin

from mbdlft.base.array import Array, ArrayLike
from mbdlft.base.errors import StructureError

_F = TypeVar("_F", bound=Callable[..., Any])
_MODELS = ("System", "LFTModel")
_ARRAYS = (Array, ArrayLike)  # names in annotations, and no classes of objects
_ADVICE = {  # by the class that is expected, and that of what came; "" for any other
    "System": {
        "Scene": "mbdlft.to_lft(scene) makes one of a scene.",
        "MatrixProblem": "mbdlft.realize(problem) makes one.",
        "Dae": "mbdlft.linearize_dae(dae) makes one.",
        "Structure": "mbdlft.linearize_dae(structure) makes one.",
        "DeltaThetaModel": "Its linear part is model.linear.",
        "str": "mbdlft.load(path) reads one.",
        "System": "A system has no evidence; to_lft, realize and linearize_dae make models that have.",
        "": "mbdlft.to_lft(scene) makes one of a scene, mbdlft.as_system(item) of numbers, matrices and "
        "python-control systems.",
    },
    "Scene": {
        "str": "mbdlft.load_scene(path) reads one from a file.",
        "LFTModel": "mbdlft.show.scene_of(model) is that of a model.",
        "": "mbdlft.load_scene(path), mbdlft.load_robot(path) and mbdlft.Scene(...) make one.",
    },
    "Dae": {
        "str": "mbdlft.load_modelica(path) reads one.",
        "": "mbdlft.dae.DaeDraft(name) and mbdlft.load_modelica(path) make one.",
    },
    "Structure": {"": "mbdlft.dae.reduce_index(dae) makes one."},
    "DeltaThetaModel": {"": "mbdlft.delta_theta(dae) makes one of a model with nonlinear functions."},
    "Bounds": {"": "robust_stability and worst_case_gain return them; load_analysis(path) reads them."},
    "Parameter": {"": "model.parameters and scene.parameters are such."},
    "Goal": {"": "mbdlft.synthesis.gain_goal(inputs, outputs) makes one."},
    "Path": {"System": "The path is first."},
    "TunableSystem": {"": "mbdlft.synthesis.tunable_gain and its like make one."},
}


class _Expected(NamedTuple):
    """What an argument is: objects of some classes, or sequences of objects of some classes."""

    place: int
    name: str
    kinds: tuple[type, ...]
    is_sequence: bool


def arguments_checked(function: _F) -> _F:
    """The function, which refuses arguments of other classes than their annotations name.

    Looked at are annotations with a class of this package, such as ``System`` or ``Scene | LFTModel``,
    sequences of such or of anything, and paths.

    Raises
    ------
    StructureError
        It names the function, the argument, what is expected, what came, and what makes one.
    """
    expectations = tuple(_expectations(function))

    @wraps(function)
    def of_expected(*arguments: Any, **named: Any) -> Any:
        for expected in expectations:
            if expected.place < len(arguments):
                _check(function.__name__, expected, arguments[expected.place])
            elif expected.name in named:
                _check(function.__name__, expected, named[expected.name])
        return function(*arguments, **named)

    return cast(_F, of_expected)


def advice(kinds: Sequence[type], value: object) -> str:
    """What makes an object of one of these classes of a value that is none."""
    came = ["str"] if isinstance(value, Path) else [c.__name__ for c in type(value).__mro__]
    names = ["System" if kind.__name__ in _MODELS else kind.__name__ for kind in kinds]
    sentences = (_ADVICE.get(name, {}).get(kind) for kind in (*came, "") for name in names)
    return next((f" {sentence}" for sentence in sentences if sentence), "")


def _expectations(function: Callable[..., Any]) -> Iterator[_Expected]:
    for place, (name, parameter) in enumerate(signature(function).parameters.items()):
        hint = parameter.annotation
        hint = getattr(hint, "__bound__", None) or hint
        hints = get_args(hint) if get_origin(hint) in (Union, UnionType) else (hint,)
        inner = get_args(hint) if get_origin(hint) is Sequence else ()
        if inner and (inner[0] is Any or _is_own(inner[0])):
            yield _Expected(place, name, () if inner[0] is Any else inner, is_sequence=True)
        elif all(isinstance(h, type) for h in hints) and (Path in hints or any(map(_is_own, hints))):
            yield _Expected(place, name, hints, is_sequence=False)


def _is_own(hint: object) -> bool:
    return isinstance(hint, type) and hint.__module__.startswith("mbdlft.") and hint not in _ARRAYS


def _check(function: str, expected: _Expected, value: object) -> None:
    what = f"{function}: {expected.name}"
    if not expected.is_sequence:
        kinds = (*expected.kinds, os.PathLike) if Path in expected.kinds else expected.kinds
        if not isinstance(value, kinds):
            raise StructureError(_refusal(what, expected.kinds, value))
        return
    if isinstance(value, str | Mapping) or not isinstance(value, Collection):
        one = f", such as [{expected.name.removesuffix('s')}]"
        kind = f" of {expected.kinds[0].__name__}" if expected.kinds else ""
        raise StructureError(f"{what}: expected a list{kind}{one}, got {said(value)}.")
    for k, item in enumerate(value if expected.kinds else ()):
        if not isinstance(item, expected.kinds):
            raise StructureError(_refusal(f"{what}[{k}]", expected.kinds, item))


def _refusal(what: str, kinds: Sequence[type], value: object) -> str:
    names = [kind.__name__ for kind in kinds if kind not in (Path, type(None))]
    if "System" in names:
        names.insert(0, "LFTModel")
    if Path in kinds:
        names.remove("str")
    *others, last = [*map(_with_article, names), *["the path of a file"] * (Path in kinds)]
    listed = f"{', '.join(others)}{' or ' * bool(others)}{last}"
    return f"{what}: expected {listed}, got {said(value)}.{advice(kinds, value)}"


def said(value: object) -> str:
    """A value in a message: its class, and its name where it has one."""
    if value is None or isinstance(value, str | Path | bool | int | float):
        return repr(value) if not isinstance(value, Path) else repr(str(value))
    name = getattr(value, "name", None)
    kind = type(value).__name__
    return f"the {kind} {name!r}" if isinstance(name, str) else _with_article(kind)


def _with_article(kind: str) -> str:
    return f"{'an' if kind == 'LFTModel' or kind[0] in 'AEIO' else 'a'} {kind}"
