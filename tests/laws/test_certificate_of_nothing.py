"""Entries that are exactly zero: their rounding does not refuse a right model, nor accept a wrong one."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import mbdlft
from mbdlft import Inertia, Parameter, PointMass, Prismatic, Revolute, RigidBody, Scene, Spin
from mbdlft.base.samples import check_points
from mbdlft.lft.lft import LFT
from mbdlft.multibody.assembly import assemble
from mbdlft.multibody.to_problem import choose_signals, problem_of_scene
from mbdlft.pipeline.stages import _Check
from mbdlft.problem.linearization import relinearize
from mbdlft.problem.references import entry_sizes
from mbdlft.show.report.content import checked_beside
from tests.close import SCENARIO

M = Parameter("m", 2.0, percent=50, unit="kg")
RATE = Parameter("rate", 2.0, percent=50, unit="rad/s")


def balanced_boom() -> Scene:
    """Without gravity the stiffness of a turning boom is W^2 m L^2 cos(2 th): zero at 45 degrees."""
    return Scene(
        name="boom",
        spin=Spin(axis=(0, 0, 1), rate="rate"),
        parameters=[M, RATE],
        bodies=[PointMass(name="tip", mass="m", ports={"root": (-0.7, 0, 0)})],
        joints=[Revolute(name="j", parent="ground", child="tip.root", axis=(0, 1, 0), position="45*deg")],
    )


def driven_rail() -> Scene:
    """The acceleration of the rail is imposed, so nothing else drives it; solving mixes the rows."""
    arm = {"mass": 1.0, "center_of_mass": (0.1, 0.3, 0.2)}
    inertia = Inertia(xx=0.3, yy=0.4, zz=0.5, xy=0.1, xz=0.05, yz=-0.07)
    return Scene(
        name="rail",
        spin=Spin(axis=(1, 2, 3), rate="rate"),
        parameters=[M, RATE],
        bodies=[
            RigidBody(name="a", **arm, inertia=inertia, ports={"tip": (0.2, 0.5, 0.1)}),
            RigidBody(name="b", **arm, inertia=inertia, ports={"tip": (0.2, 0.5, 0.1)}),
            RigidBody(name="c", mass="m", center_of_mass=(0.3, 0.1, -0.2), inertia=inertia),
        ],
        joints=[
            mbdlft.Spherical(name="ball", parent="ground", child="a", imposed=True),
            Prismatic(name="rail", parent="a.tip", child="b", axis=(3, 1, 2), imposed=True),
            Revolute(name="j", parent="b.tip", child="c", axis=(1, -2, 1), stiffness=30.0),
        ],
    )


@pytest.mark.parametrize("make", [balanced_boom, driven_rail])
def test_rounding_of_zero_does_not_refuse_a_model(make) -> None:
    assert mbdlft.to_lft(make(), search=0.0).certificate.max_relative_error <= SCENARIO


def test_what_is_compared_with_its_terms_is_listed(tmp_path: Path) -> None:
    """The stiffness of the boom is exactly zero; rounding in its place has no size of its own."""
    scene = balanced_boom()
    model = mbdlft.to_lft(scene, search=0.0)
    assert model.certificate.by_terms == ()  # zero in 50 digits, and in the model
    rounded = model.lft.M22.copy()
    rounded[1, 0] = 1e-17
    lft = replace(model.lft, M22=rounded)
    found = _Check(problem_of_scene(scene)).model(lft, model.trim.lft)
    assert found.by_terms == ((1, 0),)
    assert found.error <= SCENARIO
    model = replace(model, certificate=replace(model.certificate, by_terms=found.by_terms))
    mbdlft.save(tmp_path / "a.h5", model)
    assert mbdlft.load(tmp_path / "a.h5").certificate == model.certificate
    said = " ".join(str(part) for part in checked_beside(model))
    assert "and compared with these: dj.rate/dt by j.angle" in said


def test_sizes_of_entries_stay_up_when_these_cancel() -> None:
    scene = balanced_boom()
    equations = assemble(scene)
    signals = choose_signals(scene, equations)
    at = relinearize(equations, *signals, check_points(equations.parameters, 0))
    sizes = entry_sizes(equations, *signals, at)
    reference = np.max(np.abs(at.linear.matrices), axis=0)
    assert reference[1, 0] < SCENARIO < sizes[1, 0]
    assert np.all(sizes >= (1.0 - SCENARIO) * reference)


@pytest.mark.parametrize("make", [balanced_boom, driven_rail])
def test_a_wrong_model_is_refused_all_the_same(make) -> None:
    """Planted bugs: each column of the model off by a thousandth."""
    scene = make()
    problem = problem_of_scene(scene)
    model = mbdlft.to_lft(scene, search=0.0)
    right, trim = model.lft, model.trim.lft
    assert trim is not None
    refused = 0
    for column in np.flatnonzero(np.max(np.abs(right.M22), axis=0) > SCENARIO):
        gain = np.ones(right.M22.shape[1])
        gain[column] = 1.001
        wrong = LFT(right.M11, right.M12 * gain, right.M21, right.M22 * gain, right.blocks)
        with pytest.raises(mbdlft.AnalysisError, match="of the size of an entry of its matrices"):
            _Check(problem).model(wrong, trim)
        refused += 1
    assert refused


def test_a_stiffness_where_there_is_none_is_refused() -> None:
    """Planted bug: the balanced boom with a stiffness of a thousandth of the terms that cancel."""
    scene = balanced_boom()
    problem = problem_of_scene(scene)
    model = mbdlft.to_lft(scene, search=0.0)
    right, trim = model.lft, model.trim.lft
    assert trim is not None
    wrong = right.M22.copy()
    wrong[1, 0] += 1e-3
    with pytest.raises(mbdlft.AnalysisError, match="of the size of an entry of its matrices"):
        _Check(problem).model(LFT(right.M11, right.M12, right.M21, wrong, right.blocks), trim)
