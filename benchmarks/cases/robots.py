"""Robots of the package example-robot-data, and their linear models by pinocchio and by MuJoCo.

Both tools read the same URDF file, its numbers changed in the XML where a parameter stands for them.
Nothing of mbdlft is used, but for the tolerance below which an angle of the file is a right one:
both get it as a right one.

At rest      M qddot + D qdot + K q = effort,      K = d rnea(q, 0, 0) / dq
"""

import xml.etree.ElementTree as ET
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.metadata import distribution
from pathlib import Path

import numpy as np

BASE = tuple(f"root_joint.{effort}.{axis}" for effort in ("force", "torque") for axis in "xyz")
_RIGHT = 1e-8
_STEP = 1e-5


def robots() -> Path:
    """The folder of the robots of the package example-robot-data; raises if it is not installed."""
    package = distribution("example-robot-data")
    return Path(str(package.locate_file("cmeel.prefix/share/example-robot-data/robots")))


@dataclass(frozen=True)
class Rest:
    """The linear model at rest: coordinates in the order of the tool, matrices (n, n), efforts (n,).

    A coordinate has the name of its joint; those of the free root are BASE.
    """

    coordinates: tuple[str, ...]
    M: np.ndarray
    K: np.ndarray
    D: np.ndarray
    effort: np.ndarray


def edited(path: Path, numbers: Mapping[str, float]) -> str:
    """The file with other numbers by label, without geometry, its right angles written out."""
    tree = ET.parse(path)
    top = tree.getroot()
    for element in top.iter("origin"):
        if "rpy" in element.attrib:
            angles = [float(text) for text in element.attrib["rpy"].split()]
            element.set("rpy", " ".join(repr(_right(angle)) for angle in angles))
    named = {("link", e.get("name")): e for e in top.findall("link")}
    named |= {("joint", e.get("name")): e for e in top.findall("joint")}
    for label, number in numbers.items():
        name, key, *entry = label.rsplit(".", 1 if label.endswith(".mass") else 2)
        if key == "mass":
            named["link", name].find("inertial/mass").set("value", repr(number))
        elif key == "inertia":
            named["link", name].find("inertial/inertia").set(f"i{entry[0]}", repr(number))
        else:
            place = {"origin": ("joint", "origin"), "center_of_mass": ("link", "inertial/origin")}
            kind, where = place[key]
            _set_entry(named[kind, name].find(where), entry[0], number)
    for link in top.findall("link"):
        for part in [*link.findall("visual"), *link.findall("collision")]:
            link.remove(part)
    return ET.tostring(top, encoding="unicode")


def _right(angle: float) -> float:
    nearest = round(angle / (np.pi / 2)) * np.pi / 2
    return float(nearest) if abs(angle - nearest) < _RIGHT else angle


def _set_entry(origin: ET.Element, axis: str, number: float) -> None:
    entries = origin.get("xyz", "0 0 0").split()
    entries["xyz".index(axis)] = repr(number)
    origin.set("xyz", " ".join(entries))


def by_pinocchio(text: str, positions: Mapping[str, float], *, free: bool) -> Rest:
    """From the analytical derivatives of inverse dynamics; joints not named are at zero.

    The motion and the wrench of a free root are in its own axes.
    """
    import pinocchio as pin

    root = (pin.JointModelFreeFlyer(),) if free else ()
    model = pin.buildModelFromXML(text, *root)
    data = model.createData()
    joints = tuple(model.names[2:] if free else model.names[1:])
    angles, zero = np.zeros(model.nv), np.zeros(model.nv)
    for name, position in positions.items():
        angles[model.joints[model.getJointId(name)].idx_v] = position
    q = pin.integrate(model, pin.neutral(model), angles)
    effort = pin.rnea(model, data, q, zero, zero).copy()
    K, _, upper = (np.array(m) for m in pin.computeRNEADerivatives(model, data, q, zero, zero))
    mass = np.triu(upper) + np.triu(upper, 1).T
    damping = {e.get("name"): e.find("dynamics") for e in ET.fromstring(text).findall("joint")}
    D = [0.0 if damping[j] is None else float(damping[j].get("damping", 0)) for j in joints]
    base = BASE if free else ()
    return Rest((*base, *joints), mass, K, np.diag([0.0] * len(base) + D), effort)


def by_mujoco(text: str, positions: Mapping[str, float], *, free: bool) -> Rest:
    """From central differences of inverse dynamics; joints not named are at zero."""
    assert not free, "not needed so far"
    import mujoco

    options = '<mujoco><compiler fusestatic="false" discardvisual="true"/></mujoco></robot>'
    model = mujoco.MjModel.from_xml_string(text.replace("</robot>", options))
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
    data = mujoco.MjData(model)
    n = model.nv
    joints = tuple(model.joint(k).name for k in range(n))
    rest = np.array([positions.get(name, 0.0) for name in joints])

    def efforts(q: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
        data.qpos, data.qvel, data.qacc = q, v, a
        mujoco.mj_inverse(model, data)
        return data.qfrc_inverse.copy()

    def difference(k: int) -> np.ndarray:
        columns = []
        for step in _STEP * np.eye(n):
            up, down = ([rest, np.zeros(n), np.zeros(n)] for _ in range(2))
            up[k], down[k] = up[k] + step, down[k] - step
            columns.append((efforts(*up) - efforts(*down)) / (2 * _STEP))
        return np.stack(columns, axis=1)

    K, D, M = difference(0), difference(1), difference(2)
    return Rest(joints, M, K, D, efforts(rest, np.zeros(n), np.zeros(n)))
