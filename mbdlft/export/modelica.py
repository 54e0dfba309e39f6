"""Modelica: the linear model as equations, with its parameters as `parameter Real`.

    der(x) = A x + B_w w + B_u u,   z = C_z x + D_zw w + D_zu u,   y = C_y x + D_yw w + D_yu u,

and w = delta z for each channel, with delta = (t - b0)/(gain - a1 (t - b0)) of the internal value t of
its parameter. So nothing is expanded. Of an angle the tangent of its half or quarter is the parameter of
the Modelica model, so that all equations are rational in it. Signals are deviations from the operating
point.
"""

from collections.abc import Iterable, Sequence

import numpy as np

from mbdlft.base.array import Array
from mbdlft.base.parameter import DIVISORS, Parameter, to_internal
from mbdlft.base.unit import Signal
from mbdlft.export.matlab import TANGENT
from mbdlft.export.names import check_different, check_plain_model, identifier, one_line
from mbdlft.modelica.tree import KEYWORDS
from mbdlft.system.model import System

# before names of states, which outputs often have, too, and of outputs that inputs have, as of a joint
# whose motion is given and measured
_STATE, _OUTPUT = "x_", "y_"


def modelica_text(model: System) -> str:
    """The text of a Modelica model, in which parameters have their limits as `min` and `max`."""
    check_plain_model(model, "Modelica")
    owner = _plain(model.name)
    inputs, outputs = ([_plain(s.name) for s in those] for those in (model.inputs, model.outputs))
    outputs = [_OUTPUT + name if name in inputs else name for name in outputs]
    states = [_STATE + _plain(s.name) for s in model.states]
    values = {p.name: TANGENT[p.substitution] + _plain(p.name) for p in model.parameters}
    names = {f"parameter {name}": made for name, made in values.items()}
    for what, signals, made in zip(
        ("state", "input", "output"),
        (model.states, model.inputs, model.outputs),
        (states, inputs, outputs),
        strict=True,
    ):
        names |= {f"{what} {s.name}": text for s, text in zip(signals, made, strict=True)}
    check_different({**names, "channels w": "w", "channels z": "z"}, f"model {model.name!r}: Modelica")
    count = model.lft.M11.shape[0]
    w, z = ([f"{name}[{k + 1}]" for k in range(count)] for name in "wz")
    known = (states, w, inputs)
    channels = [f"  Real w[{count}];", f"  Real z[{count}];"] if count else []
    lines = [
        f'model {owner} "{_quoted(model.description or model.name)}"',
        *(_parameter(p, values[p.name]) for p in model.parameters),
        *_declared("input Real", model.inputs, inputs, "(start=0)"),
        *_declared("output Real", model.outputs, outputs),
        *_declared("Real", model.states, states, "(start=0)"),
        *channels,
        "equation",
        *_equations([f"der({x})" for x in states], (model.A, model.B_w, model.B_u), known),
        *_equations(z, (model.C_z, model.D_zw, model.D_zu), known),
        *_closed(model, values, w, z),
        *_equations(outputs, (model.C_y, model.D_yw, model.D_yu), known),
        f"end {owner};",
    ]
    return "\n".join(lines) + "\n"


def _plain(name: str) -> str:
    text = identifier(name)
    return f"{text}_" if text in KEYWORDS or text == "time" else text


def _quoted(text: str) -> str:
    return one_line(text).replace("\\", "\\\\").replace('"', '\\"')


def _parameter(p: Parameter, name: str) -> str:
    """The declaration of a parameter, and of an angle that of its tangent."""
    low, nominal, high = (float(x) for x in to_internal(p, [p.low, p.nominal, p.high]))
    what = f"{p.name} ({p.unit})"
    if p.is_angle:
        what = f"tan(({what} - {p.reference / p.factor!r})/{DIVISORS[p.substitution]:g})"
    return f'  parameter Real {name}(min={low!r}, max={high!r}) = {nominal!r} "{_quoted(what)}";'


def _declared(
    kind: str, signals: Iterable[Signal], names: Sequence[str], attributes: str = ""
) -> Iterable[str]:
    for s, name in zip(signals, names, strict=True):
        yield f'  {kind} {name}{attributes} "{_quoted(f"{s.name} ({s.unit})")}";'


def _equations(
    left: Sequence[str], matrices: Sequence[Array], known: Sequence[Sequence[str]]
) -> Iterable[str]:
    """Equations left = sum of parts times known signals, without what is zero."""
    for k, name in enumerate(left):
        terms = [
            f"({float(matrix[k, j])!r})*{names[int(j)]}"
            for matrix, names in zip(matrices, known, strict=True)
            for j in np.flatnonzero(matrix[k])
        ]
        yield f"  {name} = {' + '.join(terms) or '0'};"


def _closed(model: System, values: dict[str, str], w: Sequence[str], z: Sequence[str]) -> Iterable[str]:
    """w = delta z, as (gain - a1 (t - b0)) w = (t - b0) z."""
    parameters = {p.name: p for p in model.parameters}
    k = 0
    for block in model.lft.blocks:
        p = parameters[block.name]
        t = values[p.name]
        moved = f"({t} - ({p.map.b0!r}))" if p.map.b0 else t
        for _ in range(block.inputs):
            scale = f"({p.map.gain!r} - ({p.map.a1!r})*{moved})" if p.map.a1 else repr(p.map.gain)
            yield f"  {scale}*{w[k]} = {moved}*{z[k]};"
            k += 1
