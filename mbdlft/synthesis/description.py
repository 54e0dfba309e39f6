"""A task for the tuner as a TOML file: model, connections, controllers, weights and goals; and results.

The format is `mbdlft-tuning/1`. Each controller and each goal is a table with a `kind`; its other keys
are the arguments of the function that makes it.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from inspect import signature
from pathlib import Path
from typing import Any

import numpy as np

from mbdlft.archive.analysis import save_analysis
from mbdlft.archive.archive import save
from mbdlft.base.arguments import arguments_checked
from mbdlft.base.errors import MbdlftError, SceneError, check_known
from mbdlft.base.parameter import is_finite
from mbdlft.multibody.scene.toml import Kind, check_keys, check_value, read_file, read_table
from mbdlft.synthesis import laws, pieces
from mbdlft.synthesis.box import tune
from mbdlft.synthesis.goals import (
    Goal,
    acceleration_goal,
    design_goal,
    gain_goal,
    margin_goal,
    pole_goal,
    rational,
    rolloff_goal,
    tracking_goal,
)
from mbdlft.synthesis.reached import Tuning
from mbdlft.system.model import System

FORMAT = "mbdlft-tuning/1"
_CONTROLLERS: dict[str, Callable[..., pieces.TunableSystem]] = {
    "gain": pieces.tunable_gain,
    "pid": pieces.tunable_pid,
    "transfer": pieces.tunable_transfer,
    "state_space": pieces.tunable_state_space,
    "pd from inertia": laws.inertia_pd,
    "acceleration feedback": laws.acceleration_feedback,
    "positive position feedback": laws.positive_position_feedback,
    "integral force feedback": laws.integral_force_feedback,
}
_GOALS: dict[str, Callable[..., Goal]] = {
    "acceleration": acceleration_goal,
    "design": design_goal,
    "gain": gain_goal,
    "margin": margin_goal,
    "poles": pole_goal,
    "roll-off": rolloff_goal,
    "tracking": tracking_goal,
}
_WEIGHTS = ("before", "after")


@dataclass(frozen=True, slots=True, eq=False)
class TuningTask:
    """What a file asks for.

    Attributes
    ----------
    model : str
        File of the model, relative to that of the task: an archive, a scene or a matrix.
    connections : list of lists of names, as for `connect`
    inputs : tuple of names
        Inputs of the whole that stand in no goal.
    controllers : tuple of TunableSystem
    blocks : tuple of System
        Transfer functions with input ``u`` and output ``y``: delays, filters of actuators.
    schedules : mapping of names of controllers to names of parameters, and functions of them
    goals : tuple of Goal
    initial : mapping of names of free values to numbers
    leave_out : names of states, or "cyclic", as for `tune`
    """

    model: str
    connections: list[list[str]]
    inputs: tuple[str, ...]
    controllers: tuple[pieces.TunableSystem, ...]
    blocks: tuple[System, ...]
    schedules: Mapping[str, tuple[Sequence[str], Sequence[str]]]
    goals: tuple[Goal, ...]
    initial: Mapping[str, float]
    leave_out: pieces.Names = ()


@arguments_checked
def load_tuning(path: str | Path) -> TuningTask:
    """The task of the TOML file at `path`.

    Raises
    ------
    SceneError, StructureError
        The file cannot be read or is no task; the message names the file, and the controller or goal.
    """
    return read_file(path, lambda text: read_table(text, _task))


@arguments_checked
def tune_task(task: TuningTask, model: System, **options: Any) -> Tuning:
    """`tune` for a task and its model.

    Parameters
    ----------
    task : TuningTask
    model : System or LFTModel
    options : those of `tune`: starts, seed, prove, gap, work, workers, progress

    Raises
    ------
    StructureError, AnalysisError
        As `tune`; or a controller is scheduled in a parameter that the model does not have.
    """
    controllers = [
        pieces.scheduled(c, [model.parameters[name] for name in schedule[0]], schedule[1])
        if (schedule := task.schedules.get(c.name))
        else c
        for c in task.controllers
    ]
    how = {"inputs": task.inputs, "initial": task.initial, "leave_out": task.leave_out, **options}
    return tune([model, *task.blocks, *controllers], task.goals, task.connections, **how)


def _task(table: dict[str, Any]) -> TuningTask:
    keys = (
        "format", "model", "connections", "inputs", "controller", "blocks", "weights", "goals", "initial",
        "leave_out",
    )  # fmt: skip
    check_keys(table, FORMAT, keys)
    if missing := [key for key in ("model", "connections", "goals") if key not in table]:
        raise SceneError(f"{missing[0]!r} is missing.")
    for key in table.keys() & _TOP.keys():
        check_value(key, table[key], _TOP[key])
    blocks, weights = (
        {name: _transfer(f"{noun} {name!r}", name, entry) for name, entry in _tables(table, key).items()}
        for noun, key in (("block", "blocks"), ("weight", "weights"))
    )
    schedules, controllers, goals = {}, [], []
    for name, entry in _tables(table, "controller").items():
        if "scheduled" in entry:
            for key, what in (("scheduled", "names of parameters"), ("functions", "expressions")):
                if not _are_names(entry.get(key, [])):
                    raise SceneError(f"controller {name!r}: {key}: expected {what}.")
            schedules[name] = entry["scheduled"], entry.get("functions", [])
        own = ("scheduled", "functions") if "scheduled" in entry else ()
        others = {key: value for key, value in entry.items() if key not in own}
        controllers.append(_made("controller", name, others, _CONTROLLERS))
    for name, entry in _tables(table, "goals").items():
        for key in (key for key in _WEIGHTS if key in entry):
            check_known("weight", [str(entry[key])], weights, f"goal {name!r}: {key}")
        known = {k: weights[v] if k in _WEIGHTS else v for k, v in entry.items()}
        goals.append(_made("goal", name, known, _GOALS))
    return TuningTask(
        table["model"],
        table["connections"],
        tuple(table.get("inputs", ())),
        tuple(controllers),
        tuple(blocks.values()),
        schedules,
        tuple(goals),
        table.get("initial", {}),
        table.get("leave_out", ()),
    )


def _tables(table: Mapping[str, Any], key: str) -> dict[str, dict[str, Any]]:
    tables: dict[str, dict[str, Any]] = table.get(key, {})
    are_tables = partial(_by_name, is_entry=lambda entry: isinstance(entry, dict))
    check_value(key, tables, (are_tables, f"tables by name, such as [{key}.NAME]"))
    return tables


def _are_names(value: Any) -> bool:
    return isinstance(value, list) and all(isinstance(name, str) for name in value)


def _is_names(value: Any) -> bool:
    return isinstance(value, str) or _are_names(value)


def _made(noun: str, name: str, entry: Mapping[str, Any], kinds: Mapping[str, Callable[..., Any]]) -> Any:
    """What the function of a kind makes of the other keys."""
    where = f"{noun} {name!r}"
    if "kind" not in entry:
        raise SceneError(f"{where}: 'kind' is missing: expected {', '.join(kinds)}.")
    check_known("kind", [str(entry["kind"])], kinds, where)
    function = kinds[entry["kind"]]
    parameters = {key: p for key, p in signature(function).parameters.items() if key != "name"}
    given = {key: value for key, value in entry.items() if key != "kind"}
    check_known("key", given, parameters, where)
    for key, parameter in parameters.items():
        if key in given:
            check_value(f"{where}: {key}", given[key], _TYPES.get(parameter.annotation, _ANY))
        elif parameter.default is parameter.empty:
            raise SceneError(f"{where}: {key!r} is missing.")
    try:
        return function(**{**given, "name": name})
    except MbdlftError as error:
        raise type(error)(str(error) if where in str(error) else f"{where}: {error}") from None


def _is_pair(value: Any) -> bool:
    return isinstance(value, list) and len(value) == 2 and all(map(is_finite, value))


def _by_name(value: Any, is_entry: Callable[[Any], bool]) -> bool:
    return isinstance(value, dict) and all(map(is_entry, value.values()))


# of the annotation of an argument: whether a value of TOML is one that it takes, and what it takes
_TYPES: dict[Any, Kind] = {
    bool: (lambda value: isinstance(value, bool), "true or false"),
    int: (lambda value: isinstance(value, int) and not isinstance(value, bool), "a whole number"),
    float: (is_finite, "a finite number"),
    float | None: (is_finite, "a finite number"),
    str: (lambda value: isinstance(value, str), "a text"),
    pieces.Names: (_is_names, "a name or a list of names"),
    float | tuple[float, float]: (
        lambda value: is_finite(value) or _is_pair(value),
        "a finite number, or a list of two",
    ),
    Mapping[str, float] | None: (lambda value: _by_name(value, is_finite), "numbers by name"),
    pieces.Ranges | None: (lambda value: _by_name(value, _is_pair), "two numbers by name"),
}


_ANY: Kind = (lambda _: True, "")  # weights, and structures
_TOP: Mapping[str, Kind] = {
    "model": (lambda value: isinstance(value, str), "the name of a file"),
    "connections": (
        lambda value: isinstance(value, list) and all(map(_are_names, value)),
        "lists of names, such as [['e', 'r', '-y']]",
    ),
    "inputs": (_are_names, "a list of names"),
    "leave_out": (_is_names, "names of states, or 'cyclic'"),
    "initial": (partial(_by_name, is_entry=is_finite), "numbers by name of values"),
}


def _transfer(where: str, name: str, entry: Mapping[str, Any]) -> System:
    """A transfer function of its coefficients, the highest power first."""
    check_known("key", entry, ("numerator", "denominator"), where)
    lists = []
    for key in ("numerator", "denominator"):
        values = entry.get(key)
        if not (isinstance(values, list) and values and all(map(is_finite, values)) and values[0] != 0):
            raise SceneError(
                f"{where}: {key}: expected numbers, the highest power of s first and not zero, "
                f"got {values!r}."
            )
        lists.append(np.array(values, dtype=float))
    if len(lists[0]) > len(lists[1]):
        raise SceneError(f"{where}: the numerator has a higher power of s than the denominator.")
    return rational(name, *lists)


@arguments_checked
def save_tuning(path: str | Path, tuning: Tuning) -> None:
    """Write controllers, loops and proofs into an archive; `mbdlft verify` checks the proofs.

    `mbdlft report` of a controller has its goals.

    Parameters
    ----------
    path : file, made if it does not exist
    tuning : Tuning
    """
    said = "\n".join(["tuned:", *(reached.found for reached in tuning.goals)])
    for controller in tuning.controllers:
        save(path, replace(controller, description=said))
    names = ", ".join(c.name for c in tuning.controllers) or "the design"
    for reached in tuning.goals:
        about = f"goal of {names}: {reached.goal.name}, limit {reached.goal.limit:.6g}"
        loop = replace(reached.loop, description=about)
        if reached.bounds:  # of an earlier loop of this name
            save(path, loop)
        for bounds in reached.bounds:
            save_analysis(path, loop, bounds)
