"""A chain of inertias and gears, with springs or rigid shafts: seconds of one core and memory.

Usage: ``python -m benchmarks.geared_chain [STAGES ...]``; each line of the table is a process of its own.
"""

import resource
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context

import mbdlft
from mbdlft.modelica import flat_model, operating_point, translate

_STAGES = ((36, 22), (91, 56), (182, 111))  # of rigid shafts, of springs: 400, 1000, 2000 equations
_ANGLES = ("in{i}.a.phi", "in{i}.b.phi", "in{i}.phi", "ge{i}.a.phi", "ge{i}.b.phi")
_TORQUES = ("in{i}.a.tau", "in{i}.b.tau", "ge{i}.a.tau", "ge{i}.b.tau")
_STAGE = """in{i}.phi = in{i}.a.phi; in{i}.phi = in{i}.b.phi; der(in{i}.phi) = in{i}.w;
der(in{i}.w) = in{i}.a; J{i}*in{i}.a = in{i}.a.tau + in{i}.b.tau;
ge{i}.a.phi = {ratio}*ge{i}.b.phi; 0 = {ratio}*ge{i}.a.tau + ge{i}.b.tau;
in{i}.b.phi = ge{i}.a.phi; in{i}.b.tau + ge{i}.a.tau = 0;"""
_SPRING = """sp{i}.phi = sp{i}.b.phi - sp{i}.a.phi; sp{i}.w = der(sp{i}.phi);
sp{i}.tau = c{i}*sp{i}.phi + 0.5*sp{i}.w; sp{i}.b.tau = sp{i}.tau; sp{i}.a.tau = -sp{i}.tau;"""


def ratio(stage: int) -> float:
    """What the angle before a gear is, over that behind it."""
    return 1.0 + stage % 3 / 4.0


def geared_chain(stages: int, *, springs: bool) -> str:
    """Flat Modelica, with a spring at the end; some inertias and some of many springs stay."""
    declared, equations = ["input Real u;", "output Real y;"], ["in0.a.tau = u;"]
    for i in range(stages):
        stays = i % max(1, stages // 3) == 0
        last, names = i + 1 == stages, (*_ANGLES, *_TORQUES, "in{i}.w", "in{i}.a")
        declared.append(f"parameter Real J{i}{'(min=0.5, max=2)' * stays} = {1.0 + i % 7 / 10.0};")
        equations.append(_STAGE.format(i=i, ratio=ratio(i)))
        ends = [f"ge{i}.b", f"in{i + 1}.a"]
        if springs or last:
            names += tuple(
                f"sp{{i}}.{x}" for x in ("a.phi", "a.tau", "b.phi", "b.tau", "phi", "w", "tau")
            )
            declared.append(f"parameter Real c{i}{'(min=50, max=200)' * stays} = {100 + i % 5};")
            equations.append(_SPRING.format(i=i))
            ends[1:1] = [f"sp{i}.a", f"sp{i}.b"]
        pairs = zip(ends[::2], ends[1::2], strict=True)
        joined = [f"{a}.phi = {b}.phi; {a}.tau + {b}.tau = 0;" for a, b in pairs]
        equations += [*joined[:-1], f"sp{i}.b.phi = 0;"] if last else joined
        declared += [f"Real {name.format(i=i)};" for name in names]
    equations.append(f"y = in{stages - 1}.w;")
    return "\n".join(["model Chain", *declared, "equation", *equations, "end Chain;"])


def _measured(stages: int, *, springs: bool) -> str:
    begun = time.process_time()
    dae, report = translate(flat_model(geared_chain(stages, springs=springs)))
    at = operating_point(dae, report)
    model = mbdlft.linearize_dae(at)
    seconds, memory = time.process_time() - begun, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    of = "springs" if springs else "rigid shafts"
    numbers = f"{len(dae.equations)} | {len(at.structure.states)} | {model.order}"
    return f"| {of} | {numbers} | {seconds:.1f} | {memory / 1024:.0f} |"


def main() -> None:
    """Print a line for each chain."""
    print("| chain of | equations | states | order | s | MB |\n|---|---|---|---|---|---|", flush=True)
    for pair in [(int(n), int(n)) for n in sys.argv[1:]] or _STAGES:
        for springs, stages in enumerate(pair):
            with ProcessPoolExecutor(1, get_context("spawn")) as own:
                print(own.submit(_measured, stages, springs=bool(springs)).result(), flush=True)


if __name__ == "__main__":
    main()
