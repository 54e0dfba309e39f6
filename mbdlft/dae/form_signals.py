"""Inputs and outputs of the relations of a Delta-Theta form, with units where these follow."""

from collections.abc import Mapping

import casadi as ca

from mbdlft.base.errors import SceneError
from mbdlft.base.unit import Signal, dimension_name, parse_unit
from mbdlft.dae.dimensions import dimension_of, open_unit
from mbdlft.dae.structure import Structure
from mbdlft.dae.theta_form import ThetaForm
from mbdlft.exact.operators import Dimension
from mbdlft.system.theta import ONE


def signals_of(s: Structure, form: ThetaForm) -> tuple[tuple[Signal, ...], tuple[Signal, ...]]:
    """Inputs and outputs of the relations of a form.

    The unit of a function, or of an argument, is that of its signal, or what follows from units of
    signals and parameters in SI units; "1" where numbers stand that may carry any unit, and for others.
    """
    zeta, omega = _units(s, form)
    inputs = [Signal(q.name, q.unit) for q in s.inputs]
    inputs += [Signal(ONE, "1")] if form.one.numel() else []
    inputs += [Signal(name, unit) for (name, _, _), unit in zip(form.functions, zeta, strict=True)]
    outputs = [Signal(y.name, y.unit) for y in s.dae.outputs]
    outputs += [
        Signal(name, unit) for (name, _, _), unit in zip(form.arguments, omega, strict=True)
    ]
    return tuple(inputs), tuple(outputs)


def _units(s: Structure, form: ThetaForm) -> tuple[list[str], list[str]]:
    """Units of zeta and of omega."""
    known: dict[int, str] = {q.symbol.element_hash(): q.unit for q in s.quantities}
    known |= {rate.element_hash(): _rate(q.unit) for q, rate in zip(s.states, s.rates, strict=True)}
    symbols = ca.vertsplit(form.relations.p)
    known |= {
        symbol.element_hash(): "1" if p.is_angle else p.unit
        for p, symbol in zip(s.dae.parameters, symbols, strict=True)
    }
    zeta, omega = ["1"] * len(form.functions), ["1"] * len(form.arguments)
    for _ in range(len(zeta) + 1):  # functions of functions
        before = list(zeta)
        known |= {z.element_hash(): unit for z, unit in zip(form.zeta, zeta, strict=True)}
        omega = [_unit(psi, known) for _, _, psi in form.arguments]
        own = {
            symbol.element_hash(): unit
            for (_, symbol, _), unit in zip(form.arguments, omega, strict=True)
        }
        zeta = [_unit(expression, own) for _, expression, _ in form.functions]
        if zeta == before:
            break
    return zeta, omega


def _rate(unit: str) -> str:
    return f"{unit}/s" if unit != "1" else "1"


def _unit(expression: ca.SX, known: Mapping[int, str]) -> str:
    """The unit of an expression; "1" where nothing follows."""
    if expression.is_symbolic():
        return known.get(expression.element_hash(), "1")
    used = {x.element_hash(): known.get(x.element_hash(), "1") for x in ca.symvar(expression)}
    if any(parse_unit(unit).factor != 1.0 for unit in used.values()):
        return "1"
    try:
        found = dimension_of(expression, {key: open_unit(unit) for key, unit in used.items()})
    except SceneError:  # the slope of a function was moved out of it as a number
        return "1"
    return dimension_name(found.exponents or _NONE) if isinstance(found, Dimension) else "1"


_NONE = (0, 0, 0, 0, 0)
