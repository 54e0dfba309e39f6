"""What a scene costs with everything requested and with one transfer, and a plane in space.

    python -m benchmarks.needs [--repeats N] [--write PAGE]

Every model is verified before its row is printed: its certificate compares it with the nonlinear
equations, and the one transfer is the same in all models of a scene. Seconds are the least processor
seconds of a few runs, from the scene to the certified model, without search.
"""

import argparse
import json
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

import mbdlft
from benchmarks.arm import machine, write_between
from benchmarks.scaling import scene as chain_scene
from benchmarks.targets import BALANCE
from mbdlft.multibody.assembly import assemble
from mbdlft.multibody.to_problem import choose_signals, choose_states
from mbdlft.pipeline.certification import ACCEPTED
from mbdlft.pipeline.models import build
from mbdlft.problem.sx.constants import in_doubles

SCENARIOS = Path(__file__).parents[1] / "scenarios"
LINKS = 10
FREQUENCIES = (0.05, 0.9, 13.0)  # rad/s
TURNED = np.array([[0.36, 0.48, -0.8], [-0.8, 0.6, 0.0], [0.48, 0.64, 0.6]])


class Transfer(NamedTuple):
    """One input and one output of a scene."""

    scene: Callable[[], mbdlft.Scene]
    source: str
    target: str


class Cost(NamedTuple):
    """What a model costs; `signals` are inputs and outputs."""

    system: str
    requested: str
    states: int
    signals: str
    instructions: int
    channels: int
    order: int
    seconds: float


def chain() -> mbdlft.Scene:
    """Ten links in space with sensors at the tip; 5 parameters."""
    tip = f"link{LINKS - 1}.tip"
    sensors = [
        mbdlft.Position(name="tip", port=tip),
        mbdlft.Accelerometer(name="accelerometer", port=tip),
        mbdlft.JointWrench(name="base", joint="joint0"),
    ]
    scene = chain_scene("spatial chain", LINKS, few=True)
    return scene.model_copy(update={"sensors": tuple(sensors)})


def scenario(name: str) -> Callable[[], mbdlft.Scene]:
    """Reads a scene of `scenarios/`."""
    return lambda: mbdlft.load_scene(SCENARIOS / f"{name}.toml")


TRANSFERS = {
    "two_link_arm": Transfer(scenario("two_link_arm"), "shoulder.torque", "elbow.angle"),
    "ur5": Transfer(scenario("ur5"), "elbow_joint.torque", "wrist_3_joint.angle"),
    "launcher_slosh": Transfer(scenario("launcher_slosh"), "gimbal.torque", "flight.angle"),
    "balloon_gondola": Transfer(scenario("balloon_gondola"), "wheel.torque", "attitude.z"),
    "solar_arrays": Transfer(scenario("solar_arrays"), "wheel_z.torque", "flight.rotation.z"),
    "launcher_bending": Transfer(scenario("launcher_bending"), "gimbal.torque", "flight.angle"),
    "10 links, at the tip": Transfer(chain, "joint9.torque", "joint9.angle"),
    "10 links, at the base": Transfer(chain, "joint0.torque", "joint0.angle"),
}


def requests(transfer: Transfer) -> Iterator[tuple[str, mbdlft.Scene]]:
    """The scene with everything requested, with one transfer, and with what that needs."""
    scene = transfer.scene()
    equations = assemble(scene.model_copy(update={"inputs": None, "outputs": None}))
    everything: dict[str, Any] = {
        "inputs": tuple(equations.u_signals[k].name for k in equations.inputs),
        "outputs": tuple(signal.name for signal in equations.y_signals),
    }
    one = {"inputs": (transfer.source,), "outputs": (transfer.target,)}
    yield "everything", scene.model_copy(update=everything)
    yield "one transfer", scene.model_copy(update=one)
    yield "one transfer, needed states", scene.model_copy(update={**one, "states": "needed"})


def cost(system: str, requested: str, scene: mbdlft.Scene, repeats: int) -> tuple[Cost, Any]:
    """What one model costs, and the model."""
    seconds = []
    for _ in range(repeats):
        start = time.process_time()
        model = build(scene, 0.0).model
        seconds.append(time.process_time() - start)
    if not model.certificate.max_relative_error <= ACCEPTED:
        raise SystemExit(f"{system}: error {model.certificate.max_relative_error:.1e}")
    found = Cost(
        system,
        requested,
        len(model.states),
        f"{len(model.inputs)} x {len(model.outputs)}",
        instructions(scene),
        sum(model.certificate.raw_order),
        model.order,
        min(seconds),
    )
    print(json.dumps(found._asdict()), flush=True)
    return found, model


def instructions(scene: mbdlft.Scene) -> int:
    """Length of the tape of the linear relations."""
    equations = assemble(scene)
    m = choose_states(scene, equations, *choose_signals(scene, equations)).relations
    lifted = m.lifted.loads if m.lifted else ca.SX(0, 1)
    found = in_doubles(ca.vertcat(m.residual, m.output))
    tape = ca.Function("tape", [ca.vertcat(m.unknown, m.known, lifted), m.p], [found])
    return int(tape.n_instructions())


def transfers(names: Sequence[str], repeats: int) -> list[Cost]:
    """Rows of all requests of the named scenes."""
    rows = []
    for name in names:
        transfer, responses = TRANSFERS[name], []
        for requested, scene in requests(transfer):
            row, model = cost(name, requested, scene, repeats)
            rows.append(row)
            signals = [[s.name for s in part] for part in (model.outputs, model.inputs)]
            output, source = (
                part.index(signal)
                for part, signal in zip(signals, (transfer.target, transfer.source), strict=True)
            )
            values = mbdlft.random(model.parameters, 5)
            response = mbdlft.frequency_response(model, values, FREQUENCIES)
            responses.append(response[:, :, output, source])
        for response in responses[1:]:
            if not np.max(np.abs(response - responses[0])) <= BALANCE * np.max(np.abs(responses[0])):
                raise SystemExit(f"{name}: the transfer is not the same in all models.")
    return rows


def planes(repeats: int) -> list[Cost]:
    """Rows of planar mechanisms, and of the same described in space."""
    arm = scenario("two_link_arm")()
    ten = chain_scene("planar chain", LINKS, few=True)
    rows = []
    for name, scene in (("two_link_arm", arm), ("10 links", ten)):
        for requested, described in (
            ("in the plane", scene),
            ("in space: all of the inertias, points off the plane", thick(scene)),
            ("in space: a skew plane", turned(scene, TURNED)),
        ):
            rows.append(cost(name, requested, described, repeats)[0])
    if len({(row.order, row.channels) for row in rows if row.system == "two_link_arm"}) > 1:
        raise SystemExit("the arm has another order in space.")
    return rows


def thick(scene: mbdlft.Scene) -> mbdlft.Scene:
    """Bodies of a scene in the plane y-z with all entries of the inertia, and centers off it."""
    bodies = []
    for body in scene.bodies:
        if isinstance(body, mbdlft.RigidBody):
            xx = body.inertia.xx
            inertia = mbdlft.Inertia(xx=xx, yy=f"2*({xx})", zz=f"2*({xx})", xy=0.01, xz=0.02)
            center = (0.1, *body.center_of_mass[1:])
            body = body.model_copy(update={"inertia": inertia, "center_of_mass": center})
        bodies.append(body)
    return scene.model_copy(update={"bodies": tuple(bodies)})


def turned(scene: mbdlft.Scene, Q: Any) -> mbdlft.Scene:
    """A scene of rigid bodies and revolute joints in the plane y-z, its plane turned by Q."""
    bodies = []
    for body in scene.bodies:
        ports = {name: turned_vector(Q, place) for name, place in body.ports.items()}
        update: dict[str, Any] = {"ports": ports}
        if isinstance(body, mbdlft.RigidBody):
            update["center_of_mass"] = turned_vector(Q, body.center_of_mass)
            update["inertia"] = turned_inertia(Q[:, 0], body.inertia.xx)
        bodies.append(body.model_copy(update=update))
    joints = [joint.model_copy(update={"axis": turned_vector(Q, joint.axis)}) for joint in scene.joints]
    gravity = turned_vector(Q, scene.gravity)
    return scene.model_copy(update={"bodies": tuple(bodies), "joints": tuple(joints), "gravity": gravity})


def turned_vector(Q: Any, vector: Sequence[Any]) -> tuple[Any, ...]:
    """Q times a vector of numbers and expressions."""
    if all(isinstance(entry, int | float) for entry in vector):
        return tuple(float(entry) for entry in Q @ np.array(vector, dtype=float))
    return tuple(
        " + ".join(f"({row[k]:.17f})*({entry})" for k, entry in enumerate(vector) if entry != 0)
        for row in Q
    )


def turned_inertia(axis: Any, moment: Any) -> mbdlft.Inertia:
    """An inertia that is felt about one axis only."""
    entries = {
        f"{'xyz'[i]}{'xyz'[k]}": f"({axis[i] * axis[k]:.17f})*({moment})"
        for i in range(3)
        for k in range(i, 3)
    }
    return mbdlft.Inertia(**entries, unchecked=True)  # it has no thickness, so it is no body's


def import_seconds(repeats: int) -> float:
    """Least seconds of `import mbdlft` in a new process."""
    program = "import time; s = time.perf_counter(); import mbdlft; print(time.perf_counter() - s)"
    return min(
        float(subprocess.run([sys.executable, "-c", program], capture_output=True, check=True).stdout)
        for _ in range(repeats)
    )


def table(rows: Sequence[Cost], head: str) -> str:
    """Rows in Markdown."""
    lines = [
        f"| system | {head} | states | inputs x outputs | SX instructions | channels | order | ms |",
        "|---|---|---|---|---|---|---|---|",
    ]
    lines += [
        f"| {row.system} | {row.requested} | {row.states} | {row.signals} | {row.instructions} "
        f"| {row.channels} | {row.order} | {1e3 * row.seconds:.0f} |"
        for row in rows
    ]
    return "\n".join(lines)


def main() -> None:
    """Measure, print a line for each case, and write the tables if asked."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--write", type=Path)
    options = parser.parse_args()
    text = "\n\n".join(
        [
            table(transfers(list(TRANSFERS), options.repeats), "requested"),
            table(planes(options.repeats), "described"),
            f"Import of the package: {import_seconds(options.repeats):.2f} s.",
            machine(),
        ]
    )
    if options.write:
        write_between(options.write, text)


if __name__ == "__main__":
    main()
