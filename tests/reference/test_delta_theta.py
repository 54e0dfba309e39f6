"""The examples of the source against its printed matrices, up to the scaling of channels.

Source: F. Casella, F. Donida, M. Lovera, Automatic generation of LFTs from object-oriented non-linear
models with uncertain parameters (2009), equations (44), (48), (49), (50).

Slips of the print, which its own equations show: phi_0 = 0.5 in (47) makes a factor of 1/0.25, where (48)
has 1/0.5; D_131 of (50) has three rows for two channels.
"""

import numpy as np
import pytest

import mbdlft
from mbdlft.dae.theta.separation import Arrange
from mbdlft.pipeline import delta_theta
from mbdlft.system import DeltaThetaModel
from tests.close import CLOSED_FORM, published, target
from tests.daes import example_1, example_2

# rows: rates, outputs, omega; columns: states, inputs, zeta
M11_OF_44 = ("-0.5", "-0.25", "0")  # of p1, p2, p2; zero elsewhere
M12_OF_44 = [["-0.35", "0.35", "0"], ["0", "0", "0.25"], ["-4", "0", "0"]]
M21_OF_44 = [["-0.71", "0", "0"], ["0", "-0.25", "0"], ["0", "0", "-1"]]
M22_OF_44 = [["-0.5", "0.5", "0"], ["0", "0", "0.25"], ["16", "0", "0"]]

M11_OF_50 = ("-0.2", "-0.33")
M12_OF_50 = [["0"] * 4 + ["-0.14", "0", "-0.14"], ["0"] * 4 + ["0", "0", "0.33"]]
M21_OF_50 = [["0", "0"], ["0.11", "0"], ["0", "0"], ["0", "0.33"], *[["0", "0"]] * 5]
M22_OF_50 = [
    ["0", "1", "0", "0", "0", "0", "0"],
    ["0", "0", "0", "0", "0.08", "0", "0.08"],
    ["0", "0", "0", "1", "0", "0", "0"],
    ["0", "0", "0", "0", "0", "0", "-0.33"],
    ["0", "0", "1", "0", "0", "0", "0"],
    ["1", "0", "0", "0", "0", "0", "0"],
    ["0", "0", "1", "0", "0", "0", "0"],
    ["-100", "0", "100", "0", "0", "0", "0"],
]


def _half(printed: str) -> float:
    """Half a unit of the last printed digit; whole numbers are exact."""
    return 0.5 * 10.0 ** -len(printed.partition(".")[2]) if "." in printed else 0.0


def _is_printed(model: DeltaThetaModel, order: list[int], M11, M12, M21, M22) -> None:  # type: ignore[no-untyped-def]
    """The matrices of a model are the printed ones: M22, M11, and products of the others by channel."""
    lft = model.linear.lft
    for i, row in enumerate(M22):
        for j, printed in enumerate(row):
            published(float(lft.M22[i, j]), printed)
    assert np.all(np.diag(np.diag(lft.M11)) == lft.M11)
    for k, own in enumerate(order):
        published(float(lft.M11[own, own]), M11[k])
        for i in range(len(M22)):
            for j in range(len(M22[0])):
                a, b = M21[i][k], M12[k][j]
                rounding = abs(float(a)) * _half(b) + abs(float(b)) * _half(a) + _half(a) * _half(b)
                found = lft.M21[i, own] * lft.M12[own, j]
                assert abs(found - float(a) * float(b)) <= rounding + CLOSED_FORM, (i, j, k)


@pytest.mark.parametrize("arrange", ["fewest", "blocks"])
def test_example_1(arrange: Arrange) -> None:
    model = delta_theta(example_1(), arrange)
    assert dict(model.linear.lft.blocks) == {"p1": 1, "p2": 2}
    assert model.linear.certificate.minimal
    assert [str(f) for f in model.functions] == ["theta.sine.y(k1_y) = sin(k1_y)"]
    loops = np.diag(model.linear.lft.M11)[1:]
    order = [0, *(1 + np.argsort(loops)).tolist()]
    _is_printed(model, order, M11_OF_44, M12_OF_44, M21_OF_44, M22_OF_44)


def test_example_1_at_values() -> None:
    model = delta_theta(example_1())
    values = {"p1": np.array([1.0, 2.2, 3.0]), "p2": np.array([3.3, 4.0, 5.0])}
    A, B, C, D = mbdlft.matrices_at(model.linear, values)
    target(A[:, 0, 0], -1 / values["p1"], CLOSED_FORM)
    target(B[:, 0, 0], 1 / values["p1"], CLOSED_FORM)
    target(C[:, 1, 0], 4 * values["p2"], CLOSED_FORM)
    target(D[:, 0, 1], 1 / values["p2"], CLOSED_FORM)


def test_example_2_as_the_blocks_are() -> None:
    model = delta_theta(example_2(), "blocks")
    assert dict(model.linear.lft.blocks) == {"p1": 1, "p2": 1}
    assert model.linear.certificate.minimal
    alpha, torque = model.functions
    assert alpha.signals == ("omega.J1.phi", "omega.J2.phi")
    assert torque.signals == ("omega.spring.tau_l", "omega.spring.alpha")
    assert torque.text == "spring_tau_l*(spring_alpha + 1)"
    # the last row, of alpha, is 4 zeta_1 here: (47) has 1/0.25 in front of the square
    rows = [*M22_OF_50, ["0", "0", "0", "0", "0", "4", "0"]]
    _is_printed(model, [0, 1], M11_OF_50, M12_OF_50, M21_OF_50, rows)


def test_example_2_with_fewest_inputs() -> None:
    model = delta_theta(example_2(), "fewest")
    assert dict(model.linear.lft.blocks) == {"p1": 1, "p2": 1}
    assert (len(model.functions), len(model.omega)) == (1, 1)
    (f,) = model.functions
    phi = np.linspace(-1.0, 1.0, 9)
    A, B, C, D = mbdlft.matrices_at(model.linear, {})
    omega = {model.omega[0]: C[1, 0] * phi}
    torque = B[3, 1] * mbdlft.theta_values(model.functions, omega)[f.name]
    target(3.0 * torque, 100 * phi * (1 + phi**2 / 0.25), CLOSED_FORM)
    assert np.all(D[1] == 0)
    assert A[0, 1] == 1
