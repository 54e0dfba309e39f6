"""The condition of the certificate: by hand, against a closed form, and in what is printed and stored."""

import numpy as np
import pytest

import mbdlft
from mbdlft.exact.rounding import conditioning
from tests.close import EPS, conditioned, exact
from tests.scenarios.commands import run

G = 9.81


def column(*values: float) -> np.ndarray:
    """One entry at several points (N, 1, 1)."""
    return np.array(values)[:, None, None]


@pytest.mark.parametrize(
    ("values", "sizes", "scale", "expected"),
    [
        ((1.0, 2.0), (1.0, 2.0), 2.0, (1.0, 0)),
        ((1.0, 2.0), (5.0, 6.0), 2.0, (5.0, 0)),  # relative to itself: 5/1, not 6/2
        ((-1.0, -2.0), (5.0, 6.0), 2.0, (5.0, 0)),
        ((0.1, 2.0), (5.0, 6.0), 2.0, (10.0, 0)),  # negligible at a point: 5/0.5
        ((-0.5, 2.0), (5.0, 6.0), 2.0, (3.0, 1)),  # changes its sign: 6/2
        ((0.0, 2.0), (5.0, 6.0), 2.0, (3.0, 1)),  # vanishes at a point
        ((EPS, 2.0), (5.0, 6.0), 2.0, (3.0, 1)),  # nothing but rounding at a point
        ((EPS, 2 * EPS), (5.0, 6.0), 2.0, (1.0, 0)),  # nothing but rounding at all
        ((0.0, 0.0), (0.0, 0.0), 1.0, (1.0, 0)),
        ((1e-3, 2e-3), (0.5, 0.6), 0.1, (6.0, 0)),  # negligible: relative to its scale
        ((-1e-3, 2e-3), (0.5, 0.6), 0.1, (6.0, 0)),
    ],
)
def test_by_hand(
    values: tuple[float, ...], sizes: tuple[float, ...], scale: float, expected: tuple[float, int]
) -> None:
    condition, changes = conditioning(
        column(*values), column(*sizes), np.array([[scale]]), np.array([[0.5]])
    )
    conditioned(condition, expected[0], 1.0)
    assert changes == expected[1]


def test_no_entries() -> None:
    assert conditioning(np.zeros((2, 0, 3)), np.zeros((2, 0, 3)), *np.ones((2, 0, 3))) == (1.0, 0)


def buckling(near: float, far: float) -> mbdlft.Scene:
    """An inverted pendulum of 1 kg and 1 m whose spring balances gravity but for these parts of it."""
    low, high = sorted((G * (1.0 + near), G * (1.0 + far)))
    return mbdlft.Scene(
        name="buckling",
        gravity=(0.0, 0.0, -G),
        parameters=[mbdlft.Parameter("k", 0.5 * (low + high), low=low, high=high, unit="N m/rad")],
        bodies=[mbdlft.PointMass(name="bob", mass=1.0, ports={"foot": (0, 0, -1.0)})],
        joints=[
            mbdlft.Revolute(
                name="pivot", parent="ground", child="bob.foot", axis=(1, 0, 0), stiffness="k"
            )
        ],
        inputs=["pivot.torque"],
        outputs=["pivot.acceleration"],
    )


@pytest.mark.parametrize("near", [1e-3, 1e-6, -1e-9])
def test_a_stiffness_that_nearly_cancels(near: float) -> None:
    """X = (m g - k)/m: its terms are (m g + k)/m, and solving adds X itself."""
    certificate = mbdlft.to_lft(buckling(near, 3.0 * near), search=0.0).certificate
    stiffness = G * (1.0 + near)
    expected = (G + stiffness) / abs(G - stiffness) + 1.0
    conditioned(certificate.condition, expected, 1.0 / abs(near))
    assert certificate.sign_changes == 0


def test_a_stiffness_that_changes_its_sign() -> None:
    """Terms of 2.2 m g at the upper end of the range, where the entry has its largest size 0.2 m g."""
    certificate = mbdlft.to_lft(buckling(-0.1, 0.2), search=0.0).certificate
    # the acceleration is an output, too
    assert certificate.sign_changes == 2
    conditioned(certificate.condition, 2.2 / 0.2 + 1.0, 100.0)


def test_it_is_stored(tmp_path) -> None:  # type: ignore[no-untyped-def]
    model = mbdlft.to_lft(buckling(1e-6, 2e-6), search=0.0)
    mbdlft.save(tmp_path / "a.h5", model)
    found = mbdlft.load(tmp_path / "a.h5").certificate
    exact([found.condition, found.sign_changes], [model.certificate.condition, 0])


def test_it_is_printed(tmp_path, monkeypatch, capsys) -> None:  # type: ignore[no-untyped-def]
    """Ill-conditioned problems are called so; changes of the sign are explained."""
    for scene, expected in (
        (buckling(1e-3, 3e-3), ["condition 2.0e+03: rounding of numbers alone may change"]),
        (buckling(-1e-9, -2e-9), ["ill-conditioned, condition 2.0e+09: ", "by 4.4e-07 of itself"]),
        (buckling(-0.1, 0.2), ["condition 1.2e+01: ", "; 2 entries change their sign"]),
    ):
        mbdlft.save(tmp_path / "a.h5", mbdlft.to_lft(scene, search=0.0))
        shown = " ".join(run(monkeypatch, capsys, "show", str(tmp_path / "a.h5"))[1].split())
        assert all(text in shown for text in expected), shown
        assert ("ill-conditioned" in shown) == ("ill-conditioned" in expected[0])


def test_what_is_derived_does_not_keep_it() -> None:
    """Entries of an inverse have another condition; it is not recorded."""
    model = mbdlft.to_lft(buckling(1e-6, 2e-6), search=0.0)
    inverse = mbdlft.invert_channels(model, ["pivot"]).certificate
    assert (inverse.condition, inverse.sign_changes) == (0.0, 0)
