"""The two-link arm and the pendulum: exactness, order and speed, as a table.

Run it from the top of the repository: python -m benchmarks.arm [--write docs/measured.md]

Times are medians in one process; whole processes are started one after the other. The answer is
verified against the closed form before any time is printed.
"""

import argparse
import os
import platform
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from statistics import median
from typing import NamedTuple

import numpy as np

import mbdlft
from benchmarks.cases.arm import (
    NAMES,
    SCENE,
    closed_form,
    full_circle_scene,
    state_and_input,
    worst_response_error,
)
from benchmarks.cases.pendulum import GRAVITY, POSITIONS, pendulum
from benchmarks.targets import CLOSED_FORM, FREQUENCY_RESPONSE
from mbdlft.pipeline.models import build

_MAIN = "from mbdlft.cli.commands import main; main()"

CERTIFICATE_STAGES = ("bound", "check")
BEGIN, END = "<!-- {} begin -->", "<!-- {} end -->"


class Row(NamedTuple):
    """One line of the table."""

    what: str
    target: str
    measured: str
    met: bool


def arm_rows(repeats: int) -> list[Row]:
    """Exactness, order and seconds of the arm."""
    text = SCENE.read_text(encoding="utf-8")
    model = mbdlft.to_lft(mbdlft.scene_from_toml(text), search=0.0)
    inside, corners = (mbdlft.random(model.parameters, 1000, seed=11), mbdlft.corners(model.parameters))
    values = {name: np.concatenate([inside[name], corners[name]]) for name in NAMES}
    expected, _ = closed_form(values)
    size = np.max(np.abs(expected), axis=(1, 2))
    error = float(np.max(np.max(np.abs(state_and_input(model, values) - expected), axis=(1, 2)) / size))
    if not error <= CLOSED_FORM:
        raise SystemExit(f"the arm is wrong: relative error {error:.1e}; no times are printed.")
    total, without = [], []
    for _ in range(repeats + 1):
        start = time.perf_counter()
        built = build(mbdlft.scene_from_toml(text), search=0.0)
        total.append(time.perf_counter() - start)
        without.append(total[-1] - sum(built.seconds[name] for name in CERTIFICATE_STAGES))
    searched = []
    for _ in range(repeats + 1):  # the first one starts the process of searches
        start = time.perf_counter()
        smallest = mbdlft.to_lft(mbdlft.scene_from_toml(text))
        searched.append(time.perf_counter() - start)
    all_in, bare = 1e3 * median(total[1:]), 1e3 * median(without[1:])  # the first one warms up
    bound = sum(model.certificate.lower_bound)
    return [
        Row(
            "arm, 7 parameters: LFT against the closed form, 1 000 random points and 128 corners, "
            "largest relative error",
            "1e-12",
            f"{error:.1e}",
            error <= CLOSED_FORM,
        ),
        Row(
            "arm: repetitions after reduction (proved lower bound, before reduction)",
            "19 (16)",
            f"{model.order} ({bound}, {sum(model.certificate.raw_order)})",
            model.order <= 19,
        ),
        Row(
            "arm with its search: repetitions, proved minimal; largest relative error; seconds in all, "
            f"and of the first model in a process (median of {repeats})",
            "16",
            f"{smallest.order}; {smallest.certificate.max_relative_error:.1e}; "
            f"{median(searched[1:]):.2f} s; {searched[0]:.2f} s",
            smallest.certificate.minimal,
        ),
        Row(
            f"arm: TOML text to reduced, certified LFT in memory, median of {repeats} (paper: 20 s)",
            "60 ms",
            f"{all_in:.0f} ms",
            all_in <= 60,
        ),
        Row("of which the reduced LFT without certificate", "30 ms", f"{bare:.0f} ms", bare <= 30),
    ]


def process_row(repeats: int) -> Row:
    """The command as a whole process, figure not drawn."""
    command = [sys.executable, "-c", _MAIN, "linearize", str(SCENE)]
    seconds = []
    with tempfile.TemporaryDirectory() as folder:
        for _ in range(repeats + 1):
            start = time.perf_counter()
            subprocess.run(
                [*command, "-o", str(Path(folder) / "arm.h5")], check=True, capture_output=True
            )
            seconds.append(time.perf_counter() - start)
    found = median(seconds[1:])
    return Row(
        f"`mbdlft linearize` on the arm as a whole process, median of {repeats}",
        "2 s",
        f"{found:.2f} s",
        found <= 2.0,
    )


def pendulum_row() -> Row:
    """Order, sign of the stiffness and error of the three pendulums."""
    worst, minimal, signs = 0.0, True, True
    for position, cosine in POSITIONS.values():
        model = pendulum(position)
        values = mbdlft.random(model.parameters, 200)
        matrices = mbdlft.matrices_at(model, values)
        exact = -GRAVITY * cosine / values["L"]
        worst = max(worst, float(np.max(np.abs(matrices.A[:, 1, 0] - exact)) / GRAVITY))
        signs &= bool(np.all(np.sign(np.round(-matrices.A[:, 1, 0], 9)) == cosine))
        minimal &= model.certificate.minimal and model.order == 3
    return Row(
        "pendulum, hanging, horizontal, inverted: order = lower bound, sign of stiffness, error",
        "3 = 3, right, exact",
        f"{'3 = 3' if minimal else 'not minimal'}, {'right' if signs else 'wrong'}, {worst:.1e}",
        minimal and signs and worst <= CLOSED_FORM,
    )


def response_row(step: float) -> Row:
    """Figure 5 of the paper: nominal response over all angles."""
    model = mbdlft.to_lft(full_circle_scene(), search=0.0)
    angles = np.concatenate([np.arange(-180.0 + step, 180.0 + step / 2, step), [-90.1, 89.9, 90.1]])
    theta1, theta2 = (axis.ravel() for axis in np.meshgrid(angles, angles))
    error = worst_response_error(model, theta1, theta2, np.logspace(-2, 3, 16))
    return Row(
        f"nominal frequency response against the closed form, both angles in (-180, 180] deg every "
        f"{step:g} deg and near +-90 deg",
        "1e-10",
        f"{error:.1e}",
        error <= FREQUENCY_RESPONSE,
    )


def evaluation_row(repeats: int, samples: int = 10_000) -> Row:
    """Microseconds a sample of one call; 10 samples are checked against single calls."""
    model = mbdlft.to_lft(mbdlft.load_scene(SCENE), search=0.0)
    values = mbdlft.random(model.parameters, samples)
    found = mbdlft.matrices_at(model, values)
    for k in range(0, samples, samples // 10):
        single = mbdlft.matrices_at(model, {name: float(v[k]) for name, v in values.items()})
        if not np.allclose(found.A[k], single.A, rtol=CLOSED_FORM, atol=CLOSED_FORM):
            raise SystemExit("evaluation at many samples is not evaluation at each of them.")
    seconds = []
    for _ in range(repeats):
        start = time.perf_counter()
        mbdlft.matrices_at(model, values)
        seconds.append(time.perf_counter() - start)
    each = 1e6 * median(seconds) / samples
    return Row(
        f"evaluation of the LFT at {samples} samples in one call, median of {repeats}",
        "10 us a sample",
        f"{each:.1f} us",
        each <= 10,
    )


def responses_row(repeats: int, samples: int = 300, frequencies: int = 200) -> Row:
    """Milliseconds of one call; 20 values are checked against elimination, one by one."""
    model = mbdlft.to_lft(mbdlft.load_scene(SCENE), search=0.0)
    values, omega = mbdlft.random(model.parameters, samples), np.geomspace(0.1, 1e3, frequencies)
    found = mbdlft.frequency_response(model, values, omega)
    A, B, C, D = mbdlft.matrices_at(model, values)
    for k, f in zip(range(0, samples, samples // 20), range(0, frequencies, 10), strict=True):
        shifted = 1j * omega[f] * np.eye(A.shape[1]) - A[k]
        if not np.allclose(
            found[k, f], C[k] @ np.linalg.solve(shifted, B[k]) + D[k], rtol=FREQUENCY_RESPONSE
        ):
            raise SystemExit("responses of many samples are not those of each of them.")
    seconds = []
    for _ in range(repeats):
        start = time.perf_counter()
        mbdlft.frequency_response(model, values, omega)
        seconds.append(time.perf_counter() - start)
    each = 1e3 * median(seconds)
    return Row(
        f"arm: responses of {samples} samples at {frequencies} frequencies, median of {repeats}",
        "50 ms",
        f"{each:.0f} ms",
        each <= 50,
    )


def rows(repeats: int = 20, step: float = 5.0) -> list[Row]:
    """All rows of the table."""
    return [
        *arm_rows(repeats),
        process_row(max(1, repeats // 4)),
        pendulum_row(),
        response_row(step),
        evaluation_row(max(1, repeats // 4)),
        responses_row(repeats),
    ]


def table(found: list[Row]) -> str:
    """The rows in Markdown."""
    lines = ["| what | target | measured |", "|---|---|---|"]
    lines += [f"| {r.what} | {r.target} | {r.measured}{'' if r.met else ' (missed)'} |" for r in found]
    return "\n".join([*lines, "", machine()])


def machine() -> str:
    """Where it was measured."""
    kind = f"{platform.system()} {platform.machine()}, {os.cpu_count()} cores"
    versions = f"Python {platform.python_version()}, numpy {np.__version__}"
    return f"Measured on {kind}, {versions}, a shared and noisy machine."


def write_between(path: Path, text: str, what: str = "benchmark") -> None:
    """Put a text between the two marks of a page that have a name."""
    page, begin, end = path.read_text(encoding="utf-8"), BEGIN.format(what), END.format(what)
    before, _, rest = page.partition(begin)
    _, _, after = rest.partition(end)
    path.write_text(f"{before}{begin}\n{text}\n{end}{after}", encoding="utf-8")


def main() -> None:
    """Print the table, and write it into a file between its two marks if asked."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--write", type=Path)
    parser.add_argument("--repeats", type=int, default=20)
    options = parser.parse_args()
    text = table(rows(options.repeats))
    print(text)
    if options.write:
        write_between(options.write, text)


if __name__ == "__main__":
    main()
