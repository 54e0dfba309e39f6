"""The same scene or matrix with the kernels of two processors: equal orders and bounds, equal values.

One is this processor, seeds take others in turn. A process for each kind of kernels is kept;
`OPENBLAS_CORETYPE` counts when numpy is imported.
"""

import atexit
import json
import re
import subprocess
import sys
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

import mbdlft
from mbdlft import MbdlftError
from mbdlft.problem.references import NEGLIGIBLE
from tests.attack import matrices, process_of
from tests.attack.mutations import check_message
from tests.close import CORES
from tests.cross.mechanisms import closed_loop, open_tree
from tests.strategies import random_scene

ROOT = Path(__file__).parents[2]
NEEDED = {"Prescott": "", "Haswell": "avx2", "SkylakeX": "avx512f"}  # of the processor
SCENARIOS = ("pendulum", "two_link_arm", "crane", "gimbal", "four_bar", "spinning_satellite")


def attack(seed: int, folder: Path) -> str:
    """Build a model with the kernels of this process and with others, and compare."""
    kind = kinds()[seed % len(kinds())]
    _ask(kind, seed)
    first, other = json.loads(json.dumps(answer(seed))), _answer(kind)
    assert first["said"] == other["said"], json.dumps([first["said"], other["said"]])
    assert first["order"] == other["order"], f"orders {first['order']} and {other['order']}"
    a, b = (np.array(each["values"]) for each in (first, other))
    if a.size:
        size = np.max(np.abs(a), axis=0)
        scale = np.where(size > NEGLIGIBLE * (both := matrices.balanced(size)), size, both)
        worst = float(np.max(np.max(np.abs(a - b), axis=0) / np.where(scale > 0, scale, 1.0)))
        assert worst <= max(CORES, 100.0 * first["error"]), f"values differ by {worst:.1e}"
    return str(first["word"])


@cache
def kinds() -> tuple[str, ...]:
    """Kinds of kernels that this processor has."""
    try:
        own = Path("/proc/cpuinfo").read_text(encoding="ascii", errors="replace")
    except OSError:
        own = ""
    return tuple(kind for kind, flag in NEEDED.items() if re.search(rf"\b{flag}\b", own))


def _ask(kind: str, seed: int) -> None:
    process = _worker(kind)
    assert process.stdin is not None
    process.stdin.write(f"{seed}\n")
    process.stdin.flush()


def _answer(kind: str) -> dict[str, Any]:
    process = _worker(kind)
    assert process.stdout is not None
    answer: dict[str, Any] = json.loads(process.stdout.readline())
    assert "failed" not in answer, answer["failed"]
    return answer


@cache
def _worker(kind: str) -> "subprocess.Popen[str]":
    """A process with the kernels of a kind; it ends with this one."""
    process = process_of("tests.attack.cores", OPENBLAS_CORETYPE=kind)
    atexit.register(process.kill)
    return process


# in the processes ----------------------------------------------------------------------------


def answer(seed: int) -> dict[str, Any]:
    """What is said of the model of a seed, and its values (N, ., .) at some points."""
    random = np.random.default_rng(seed)
    search = float(random.choice([0.0, 0.5]))
    try:
        word, model = build(random, seed, search)
    except MbdlftError as error:
        check_message(error)
        said = [type(error).__name__, re.sub(r"[\d.]+(e[-+]?\d+)?", "0", str(error))]
        return {"word": f"refused: {said[0]}", "said": said, "order": [], "error": 0.0, "values": []}
    found = model.certificate
    said = [found.lower_bound, found.raw_order, found.well_posed]
    order = [found.order, found.order_bound, len(found.open_boxes)]
    points = mbdlft.random(model.parameters, 8, seed=seed)
    A, B, C, D = mbdlft.matrices_at(model, points)
    values = np.concatenate([np.concatenate([A, B], axis=-1), np.concatenate([C, D], axis=-1)], axis=-2)
    values = values if values.ndim == 3 else values[None]
    return {
        "word": word,
        "said": said,
        "order": order,
        "error": found.max_relative_error,
        "values": values.tolist(),
    }


def build(random: np.random.Generator, seed: int, search: float) -> tuple[str, mbdlft.LFTModel]:
    """A random matrix, a random scene or a scenario."""
    kind = random.random()
    if kind < 0.3:
        drawn = matrices.draw(random, str(random.choice(matrices.FAMILIES)))
        return "matrix", mbdlft.realize(drawn.rows, drawn.parameters, states=drawn.states, search=search)
    if kind < 0.35:
        name = SCENARIOS[int(random.integers(len(SCENARIOS)))]
        scene = mbdlft.load_scene(ROOT / "scenarios" / f"{name}.toml")
    else:
        makers = (random_scene, open_tree, closed_loop)
        scene = makers[int(random.integers(len(makers)))](seed)
    return "scene", mbdlft.to_lft(scene, search=search)


def main() -> None:
    """Answer each seed of standard input with a line of JSON."""
    import warnings

    warnings.simplefilter("ignore")
    for line in sys.stdin:
        try:
            found = answer(int(line))
        except BaseException as error:
            found = {"failed": f"{type(error).__name__}: {error}"[:1000]}
        sys.stdout.write(json.dumps(found) + "\n")
        sys.stdout.flush()


if __name__ == "__main__":
    main()
