"""The UR5 with a payload and six scheduled joint angles: from its URDF file to a certified model.

Run it from the top of the repository: python -m benchmarks.ur5 [--search SECONDS]

It needs the extra `robots`. The model is verified against pinocchio before any time is printed.
"""

import argparse
import time
from pathlib import Path
from statistics import median

import numpy as np

import mbdlft
from benchmarks.arm import machine
from benchmarks.cases.robots import by_pinocchio, edited
from benchmarks.targets import PINOCCHIO
from mbdlft.pipeline.models import Build, build
from scenarios.ur5 import urdf

POSE = {
    "shoulder_pan_joint": 0.0,
    "shoulder_lift_joint": -60.0,
    "elbow_joint": 70.0,
    "wrist_1_joint": -100.0,
    "wrist_2_joint": 90.0,
    "wrist_3_joint": 0.0,
}
ANGLES = {joint: f"theta{k}" for k, joint in enumerate(POSE, start=1)}
HALF_RANGE = 30.0  # deg


def scene(path: Path) -> mbdlft.Scene:
    """The robot with its payload and all its joint angles as parameters."""
    made, _ = mbdlft.load_robot(
        path,
        parameters=[
            mbdlft.Parameter("payload", 2.5, 0.0, 5.0, unit="kg"),
            *(mbdlft.Angle(name, POSE[joint], plus=HALF_RANGE) for joint, name in ANGLES.items()),
        ],
        values={"tool0.mass": "payload"} | {f"{j}.position": name for j, name in ANGLES.items()},
    )
    return made


def worst_error(model: mbdlft.LFTModel, path: Path, count: int = 20) -> float:
    """Largest relative error of [A B] at random points, against pinocchio."""
    points = mbdlft.random(model.parameters, count, seed=7)
    A, B, _, _ = mbdlft.matrices_at(model, points)
    own, n, worst = [signal.name.partition(".")[0] for signal in model.inputs], len(POSE), 0.0
    for k in range(count):
        positions = {joint: float(np.radians(points[name][k])) for joint, name in ANGLES.items()}
        text = edited(path, {"tool0.mass": float(points["payload"][k])})
        rest = by_pinocchio(text, positions, free=False)
        order = [rest.coordinates.index(name) for name in own]
        inverse = np.linalg.inv(rest.M[np.ix_(order, order)])
        stiffness = -inverse @ rest.K[np.ix_(order, order)]
        for found, expected in ((B[k, n:], inverse), (A[k, n:, :n], stiffness)):
            worst = max(worst, float(np.max(np.abs(found - expected)) / np.max(np.abs(expected))))
    return worst


def measure(path: Path, search: float, repeats: int) -> tuple[list[float], Build]:
    """Seconds from the file to the model, first the one that warms up, and the last result."""
    seconds, built = [], None
    for _ in range(repeats + 1):
        start = time.perf_counter()
        built = build(scene(path), search)
        seconds.append(time.perf_counter() - start)
    assert built is not None
    return seconds, built


def table(path: Path, search: float, repeats: int = 3) -> str:
    """The measured figures in Markdown.

    Raises
    ------
    SystemExit
        The model is wrong.
    """
    seconds, built = measure(path, search, repeats)
    error = worst_error(built.model, path)
    if not error <= PINOCCHIO:
        raise SystemExit(f"the UR5 is wrong: relative error {error:.1e}; no times are printed.")
    certificate = built.model.certificate
    rows = [
        ("relative error against pinocchio at 20 points", f"{error:.1e}"),
        ("largest relative error of the certificate", f"{certificate.max_relative_error:.1e}"),
        (
            "repetitions: reduced (proved lower bound, before reduction)",
            f"{built.model.order} ({certificate.order_bound}, {sum(certificate.raw_order)})",
        ),
        (f"URDF file to certified LFT, median of {repeats}", f"{median(seconds[1:]):.2f} s"),
        *((f"of which {stage}", f"{each:.3f} s") for stage, each in built.seconds.items()),
    ]
    lines = [f"| UR5, payload and six angles, search {search:g} s | measured |", "|---|---|"]
    return "\n".join(lines + [f"| {what} | {value} |" for what, value in rows])


def main() -> None:
    """Print the table, without and with a search for a smaller model."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--search", type=float, default=2.0)
    options = parser.parse_args()
    for search in (0.0, options.search):
        print(table(urdf(), search), end="\n\n")
    print(machine())


if __name__ == "__main__":
    main()
