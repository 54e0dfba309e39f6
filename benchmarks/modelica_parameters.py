"""Examples of the Modelica Standard Library with parameters left in, against the compiler elsewhere.

Usage: ``python -m benchmarks.modelica_parameters FOLDER [PART OF A NAME ...]``; the folder is that of
`benchmarks.modelica_library`. In each example up to three numbers, chosen at random from those that its
linear model depends on, get +-20 %, and the model is made once. At all corners and at four random points
the example is then translated again, with other numbers in the place of the parameters, and its operating
point is found anew, from the nominal one; at one corner the compiler reads them as modifications. The
model at the values is compared with these equations as `benchmarks.modelica_library` says.
"""

import itertools
import random
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import mbdlft
from benchmarks.modelica_library import (
    DELAY,
    compiled_example,
    error_of,
    outputs_of,
    run_examples,
    with_outputs,
)
from mbdlft.base.errors import MbdlftError, SceneError
from mbdlft.dae.equilibria import DaeTrim
from mbdlft.modelica import FlatModel, ModelicaTable, operating_point, translate
from mbdlft.modelica.tree import Number
from mbdlft.system.model import LFTModel

SPREAD = 0.2
PARAMETERS = 3
TRIALS = 8  # models that are made until one depends on so many numbers


def main() -> None:
    """Print a line for each example, and counts."""

    def checked(folder: Path, name: str) -> tuple[str, float]:
        varied, order, points, error = _checked(folder, name)
        return f"{', '.join(varied)} | {order} | {points}", error

    good, count = run_examples("parameters | order | points", checked, lambda error: error <= 1e-9)
    print(f"\n{good} of {count} agree with the check to 1e-9 at all points.")


def _checked(folder: Path, name: str) -> tuple[list[str], int, int, float]:
    """Parameters of an example, order of its LFT, number of points, error of its model there."""
    starts = _starts(_compiled(folder, name, {}))
    flat, draw = _compiled(folder, name, starts), random.Random(name)
    model, outputs, table = _model(flat, draw)
    named = {key.replace(".", "_"): key for key in table.parameters}
    nominal = {p.name: (named[p.name], p.nominal) for p in model.parameters}
    factors = [*itertools.product((1.0 - SPREAD, 1.0 + SPREAD), repeat=len(nominal))]
    corner = draw.choice(factors)
    factors += [tuple(draw.uniform(1.0 - SPREAD, 1.0 + SPREAD) for _ in nominal) for _ in range(4)]
    error = 0.0
    for at_factors in factors:
        values = {
            p: factor * value for (p, (_, value)), factor in zip(nominal.items(), at_factors, strict=True)
        }
        numbers = {key: values[p] for p, (key, _) in nominal.items()}
        again = ModelicaTable(values=numbers, delay=DELAY, point=table.point)
        error = max(error, error_of(model, values, _point(flat, again, outputs)))
        if at_factors == corner:
            plain = ModelicaTable(delay=DELAY, point=table.point)
            modified = _point(_compiled(folder, name, starts | numbers), plain, outputs)
            error = max(error, error_of(model, values, modified))
    return list(table.parameters), model.order, len(factors), error


def _starts(flat: FlatModel) -> dict[str, float]:
    """Start values of positions at the equilibrium that is found: of several, all then find this one."""
    dae, report = translate(flat, ModelicaTable(delay=DELAY))
    try:
        at = operating_point(dae, report)
    except MbdlftError:
        return {}
    names = [q.name for q in at.structure.states if "[" not in q.name and "der(" not in q.name]
    return {f"{name}.start": at.nominal[name] for name in names}


def _model(flat: FlatModel, draw: random.Random) -> tuple[LFTModel, set[str], ModelicaTable]:
    """A linear model with parameters that it depends on, its outputs, and its table."""
    held = {f.name for f in flat.fixed}
    numbers = [
        d.name
        for d in flat.declarations
        if d.variability == "parameter" and d.type == "Real" and isinstance(d.binding, Number)
        if float(d.binding.text) and d.name not in held and not d.final
    ]
    draw.shuffle(numbers)
    why: MbdlftError = SceneError(f"{flat.name}: no number of its model can be varied.")
    for point in ("equilibrium", "start"):
        best: tuple[LFTModel, set[str], ModelicaTable] | None = None
        for name in numbers[:TRIALS]:
            kept = {} if best is None else best[2].parameters
            try:
                made = _with_parameters(flat, {**kept, name: {"percent": 100 * SPREAD}}, point)
            except MbdlftError as error:
                why = error
                continue
            sizes = {block.name: block.size for block in made[0].lft.blocks}
            if all(sizes.values()):
                best = made
            if len(kept) == PARAMETERS - 1 and best is made:
                break
        if best is not None:
            return best
    raise why


def _with_parameters(
    flat: FlatModel, parameters: Mapping[str, Mapping[str, float]], point: str
) -> tuple[LFTModel, set[str], ModelicaTable]:
    """The linear model with parameters, its outputs, and its table."""
    table = ModelicaTable(parameters=dict(sorted(parameters.items())), delay=DELAY, point=point)
    dae, report = translate(flat, table)
    states = [q.name for q in operating_point(dae, report, table).structure.states]
    outputs = outputs_of(dae, states)
    return mbdlft.linearize_dae(_point(flat, table, outputs)), outputs, table


def _point(flat: FlatModel, table: ModelicaTable, outputs: set[str]) -> DaeTrim:
    """The operating point that a table asks for, of the equations with these outputs."""
    dae, report = translate(flat, table)
    return operating_point(with_outputs(dae, outputs), report, table)


def _compiled(folder: Path, name: str, values: Mapping[str, float]) -> FlatModel:
    """An example that the compiler has read, with modifications of numbers."""
    modified: dict[str, Any] = {}
    for key, value in values.items():
        inner, *path, last = modified, *key.split(".")
        for part in path:
            inner = inner.setdefault(part, {})
        inner[last] = value
    return compiled_example(folder, name, f"({_modification(modified)})")


def _modification(values: Mapping[str, Any]) -> str:
    """``a(b(c = value)), d = value``"""
    items = values.items()
    return ", ".join(
        f"{a}({_modification(x)})" if isinstance(x, dict) else f"{a} = {x!r}" for a, x in items
    )


if __name__ == "__main__":
    main()
