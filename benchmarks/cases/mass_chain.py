"""A row of masses, springs, dampers and friction as differential-algebraic equations."""

from typing import Any

import casadi as ca

from mbdlft.base import Parameter
from mbdlft.dae import Dae, DaeDraft


def chain(units: int) -> Dae:
    """Masses, springs, dampers and friction in a row: ten equations each."""
    d = DaeDraft("chain")
    m = d.parameter(Parameter("m", 1.0, percent=20, unit="kg"))
    k = d.parameter(Parameter("k", 100.0, percent=20, unit="N/m"))
    c = d.parameter(Parameter("c", 1.0, percent=20, unit="N s/m"))
    u = d.input("u", "N")
    before: tuple[Any, Any] = (0, 0)
    forces = []
    for n in range(units):
        x, v = d.variable(f"x{n}", "m"), d.variable(f"v{n}", "m/s")
        names = ("a", "stretch", "rate", "spring", "damper", "friction", "force", "total")
        named = dict(zip(names, ("m/s^2", "m", "m/s", *["N"] * 5), strict=True))
        s = {name: d.variable(f"{name}{n}", unit) for name, unit in named.items()}
        d.equation(d.der(x), equals=v)
        d.equation(d.der(v), equals=s["a"])
        d.equation(m * s["a"], equals=s["total"])
        d.equation(s["stretch"], equals=x - before[0])
        d.equation(s["rate"], equals=v - before[1])
        d.equation(s["spring"], equals=k * s["stretch"])
        d.equation(s["damper"], equals=c * s["rate"])
        d.equation(s["force"], equals=s["spring"] + s["damper"])
        d.equation(s["friction"], equals=2 * ca.tanh(10 * v / d.number(1.0)))
        forces.append(s)
        before = (x, v)
    for n, s in enumerate(forces):
        after = forces[n + 1]["force"] if n + 1 < units else -u
        d.equation(s["total"], equals=after - s["force"] - s["friction"])
    d.output(f"x{units - 1}", before[0], "m")
    return d.dae()
