"""Margins of scenarios, each in a loop with a PD law: proved bounds, and seconds of one core.

    python -m benchmarks.margins [--only ur5] [--write docs/analysis.md]

The law is u = -(kp + kd s/(lag s + 1)) y. Every proof is checked again before it is printed.
"""

import argparse
import time
from dataclasses import dataclass, replace
from pathlib import Path

import control
import numpy as np

import mbdlft
from benchmarks.arm import machine, write_between

ROOT = Path(__file__).parent.parent
GAP, WORK = 0.1, 60.0
DAMPING = 1e-3  # s, of the beams of the spacecraft, where they have some


@dataclass(frozen=True)
class Case:
    """A scenario, and the law that closes it.

    Attributes
    ----------
    name : str
    outputs, inputs : tuple of str
        Measured, and driven.
    kp, kd : tuple of float
    lag : float, s
    leave_out : tuple of str
        States on which nothing depends.
    stiffness_damping : float, s
        That the beams are given.
    """

    name: str
    outputs: tuple[str, ...]
    inputs: tuple[str, ...]
    kp: tuple[float, ...]
    kd: tuple[float, ...]
    lag: float
    leave_out: tuple[str, ...] = ()
    stiffness_damping: float = 0.0

    def model(self) -> mbdlft.LFTModel:
        """The model of the scenario."""
        text = (ROOT / "scenarios" / f"{self.name}.toml").read_text(encoding="utf-8")
        if self.stiffness_damping:
            beam = 'kind = "beam"'
            text = text.replace(beam, f"{beam}\nstiffness_damping = {self.stiffness_damping}")
        scene = mbdlft.multibody.scene_from_toml(text)
        return mbdlft.to_lft(scene, search=0.0)

    def loop(self) -> mbdlft.System:
        """The model with its law."""
        n, lag = len(self.kp), self.lag
        kp, kd = np.diag(self.kp), np.diag(self.kd)
        law = control.ss(-np.eye(n) / lag, np.eye(n) / lag, -kd / lag, kp + kd / lag)
        named = mbdlft.as_system(law, name="law", inputs=self.outputs, outputs=self.inputs)
        return mbdlft.feedback(self.model(), named)


def _flight(*axes: str) -> tuple[str, ...]:
    return tuple(f"flight.{what}.{axis}" for what in ("position", "velocity") for axis in axes)


JOINTS = ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")
PIN = Case("rotatory_spacecraft", ("pin.angle",), ("pin.torque",), (50.0,), (20.0,), 0.01)
CASES = (
    Case(
        "launcher_slosh", ("flight.angle",), ("gimbal.torque",), (-6e5,), (-6e5,), 0.02, _flight("x", "y")
    ),
    Case(
        "balloon_gondola",
        ("attitude.z", "flight.position.z"),
        ("wheel.torque", "lift.displaced_mass"),
        (50.0, 20.0),
        (200.0, 100.0),
        0.1,
        _flight("x", "y"),
    ),
    Case(
        "ur5",
        tuple(f"{joint}_joint.angle" for joint in JOINTS),
        tuple(f"{joint}_joint.torque" for joint in JOINTS),
        (400.0, 400.0, 400.0, 100.0, 50.0, 20.0),
        (80.0, 80.0, 80.0, 20.0, 5.0, 2.0),
        0.005,
    ),
    PIN,
    replace(PIN, stiffness_damping=DAMPING),
    Case(
        "solar_arrays",
        tuple(f"flight.rotation.{axis}" for axis in "xyz"),
        tuple(f"wheel_{axis}.torque" for axis in "xyz"),
        (20.0,) * 3,
        (100.0,) * 3,
        0.05,
        (
            *_flight("x", "y", "z"),
            *(f"drive_{side}.{what}" for side in ("right", "left") for what in ("angle", "rate")),
        ),
    ),
)


def row(case: Case) -> str:
    """A line of the table."""
    loop = case.loop()
    what = f"{case.name}{', beams damped' if case.stiffness_damping else ''}"
    sizes = f"{len(loop.states) - len(case.leave_out)} | {len(loop.parameters)} | {loop.order}"
    start = time.process_time()
    try:
        found = mbdlft.robust_stability(loop, gap=GAP, work=WORK, leave_out=case.leave_out)
    except mbdlft.AnalysisError as error:
        short = str(error).partition(", in which")[0]
        return f"| {what} | {sizes} | 0 | | {short} |"
    seconds = time.process_time() - start
    if found.proved:
        wrong = mbdlft.verify(loop, found)
        if wrong:
            raise SystemExit(f"{case.name}: a proof is none: {wrong}")
    said = f"{found.lower:.4g} to {found.upper:.4g}"
    return f"| {what} | {sizes} | {said} | {seconds:.1f} | {found.reason} |"


def main() -> None:
    """Print the table, and write it into a file between its two marks if asked."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", default="", help="cases whose name has this word")
    parser.add_argument("--write", type=Path)
    options = parser.parse_args()
    lines = [
        "| scenario | states | parameters | repetitions | margin | seconds | why not more |",
        "|---|---|---|---|---|---|---|",
    ]
    for case in CASES:
        if options.only in case.name:
            lines.append(row(case))
            print(lines[-1], flush=True)
    text = "\n".join(
        [*lines, "", f"Seconds of one core; gap {GAP:g}, {WORK:g} units of work. {machine()}"]
    )
    if options.write:
        write_between(options.write, text)


if __name__ == "__main__":
    main()
