"""The command `tune`: controllers of a fixed structure for goals, proved at the end."""

import math
import time
from pathlib import Path
from typing import Annotated, Any

import typer

from mbdlft import synthesis
from mbdlft.cli import options
from mbdlft.cli.output import print_json, print_table, progress_of, say

_REACHED = 1.0 + 1e-3  # what is said to be reached: hard goals are constraints of a search


def tune(
    file: Annotated[Path, typer.Argument(help="Task (TOML): model, connections, controllers, goals.")],
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="Archive for controllers, loops and proofs.")
    ] = None,
    starts: Annotated[int, typer.Option(min=1, help="Places from which the search begins.")] = 8,
    seed: Annotated[int, typer.Option(help="Which places these are.")] = 0,
    no_proof: Annotated[bool, typer.Option("--no-proof", help="Leave the proofs out.")] = False,
    gap: options.Gap = 0.01,
    work: options.Work = 30.0,
    as_json: options.AsJson = False,
) -> None:
    """Tune controllers for goals at the worst values of the parameters, and prove the result."""
    options.check_paths(output)
    start = time.perf_counter()
    task = synthesis.load_tuning(file)
    model = options.load_system(file.parent / task.model)
    how: dict[str, Any] = {"starts": starts, "seed": seed, "gap": gap, "work": work}
    with progress_of(file.stem) as progress:
        tuning = synthesis.tune_task(task, model, **how, prove=not no_proof, progress=progress.stage)
    if output is not None:
        synthesis.save_tuning(output, tuning)
    is_reached = tuning.hard <= _REACHED
    if as_json:
        print_json(
            {
                "values": tuning.values,
                "goals": [_entry(reached) for reached in tuning.goals],
                "points": list(tuning.points),
                "reached": is_reached,
                "seconds": time.perf_counter() - start,
            }
        )
    else:
        _print(tuning, output)
    if not is_reached:
        raise typer.Exit(1)


def _print(tuning: "synthesis.Tuning", output: Path | None) -> None:
    """Values, goals, and why a proof is open."""
    rows = ((name, f"{value:.6g}") for name, value in tuning.values.items())
    print_table("values", "value | number >", rows)
    entries = [_entry(reached) for reached in tuning.goals]
    goals = (
        (g["name"], "hard" if g["hard"] else "soft", *(_number(g[key]) for key in _COLUMNS))
        for g in entries
    )
    headings = " > | ".join(_COLUMNS.values())
    print_table("goals, reached at 1", f"goal | kind | {headings} >", goals)
    for reached in tuning.goals:
        say(*(f"{reached.goal.name}: {b.reason}" for b in reached.bounds if b.reason))
    if output is not None:
        say(f"controllers, loops and proofs: {output}")
    if tuning.hard > _REACHED:
        say(f"hard goals are not reached: the largest is {tuning.hard:.6g}")


_COLUMNS = {"tuned": "tuned", "worst": "worst found", "proved": "proved", "least": "no controller below"}


def _entry(reached: "synthesis.Reached") -> dict[str, Any]:
    numbers = {key: getattr(reached, key) for key in _COLUMNS}
    return {"name": reached.goal.name, "kind": reached.goal.kind, "hard": reached.goal.hard, **numbers}


def _number(value: float) -> str:
    return f"{value:.4g}" if 0.0 < value < math.inf else "-"
