"""Mechanisms of `scenarios/` with couplings and rolling wheels, against equations by hand."""

from collections.abc import Callable, Mapping
from functools import cache
from pathlib import Path

import numpy as np
import pytest

import mbdlft
from mbdlft.base.array import Array
from tests import close, kit

FOLDER = Path(__file__).parents[2] / "scenarios"
G = 9.81
P = Mapping[str, float]
ORDERS = {  # order without search, and proved bound
    "ball_turntable": (8, 6),
    "belt_gantry": (11, 9),
    "diff_drive": (10, 10),
    "differential_wrist": (15, 15),
    "lander": (21, 19),  # 19 with the search
    "motorcycle": (13, 13),
    "rolling_disk": (4, 4),
    "segway": (6, 6),
    "tower_crane": (7, 7),
    "wheelset": (8, 8),
}


@cache
def model_of(name: str) -> mbdlft.LFTModel:
    return mbdlft.to_lft(mbdlft.load_scene(FOLDER / f"{name}.toml"), search=0.0)


def diff_drive(p: P, s: complex) -> Array:
    """Speed, yaw rate, swivel and mast of a robot: Jourdain's principle, with the caster's constraint."""
    R, rc, b, d, v, t, k = 0.1, 0.04, 0.2, 0.25, p["v"], p["t"], p["k"]
    base, camera, top, front = 12.0 + p["m_load"], 1.5, 0.9, 0.05
    law = 0.6 * s + k - camera * G * top
    total = base + camera + 0.5 + 2 * (0.8 + 0.004 / R**2) + 1.6e-4 / rc**2
    bend = (camera * top**2 + 0.01) * s**2 + law
    pitch = -camera * top * s / bend  # by speed
    speed = (1 / R) / (total * s + camera * top * s**2 * pitch)
    swivel = -(d + t) / (t * s + v)  # by yaw rate w: 0 = t swivel' + v swivel + (d + t) w
    share = -(d + t) / t  # of the virtual swivel rate in the virtual yaw rate
    # lateral acceleration of each mass, and its virtual velocity, by yaw rate
    places = ((base, -0.08), (0.3, -d), (camera, front))
    roll = camera * top * (front * s + v) / bend  # the mast by yaw rate
    inertia = 0.5 + 0.01 + 2 * (0.002 + 0.8 * b**2 + 0.004 * (b / R) ** 2)
    needed = inertia * s + sum(m * x * (x * s + v) for m, x in places)
    needed -= camera * front * top * s**2 * roll
    needed += 2.8e-4 * (1 + share) * (s + s**2 * swivel)
    aside = -d - t * (1 + share)
    needed += 0.2 * aside * (-(d + t) * s - t * s**2 * swivel + v)
    yaw = (b / R) / needed
    both, against = np.array([1.0, 1.0]), np.array([-yaw, yaw])
    # the picture turns with the base and the mast
    return np.array([speed * both, against, swivel * against, roll * against, pitch * speed * both])


def lander(p: P, s: complex) -> Array:
    """Side, heave and pitch of a body on three feet, at the height of the ground; the weight tips it."""
    m, h, k, R, g = p["m"], p["h"], p["k"], 1.8, 3.71
    feet, damped, aside = np.array([1.0, -0.5, -0.5]) * R, 900.0 * s + k, 500.0 * s + p["side"] * k
    M = np.array([[m, m * h], [m * h, 0.9 * m + m * h**2]])
    K = np.diag([3.0 * aside, damped * np.sum(feet**2) - m * g * h])
    x, turn = np.linalg.solve(M * s**2 + K, [1.0, 3.0])  # a wind at 3 m
    z = 1.0 / (m * s**2 + 3.0 * damped)
    carried = [[damped * foot * turn, -damped * z] for foot in feet[:2]]
    return np.array([[x, 0.0], [0.0, z], [turn, 0.0], *carried])


BY_HAND: Mapping[str, Callable[[P, complex], Array]] = {f.__name__: f for f in (diff_drive, lander)}


@pytest.mark.parametrize("name", BY_HAND)
def test_responses_are_those_of_equations_by_hand(name: str) -> None:
    parameters = model_of(name).parameters
    samples = mbdlft.random(parameters, 3, seed=37)
    for k in range(3):
        point = {p.name: float(samples[p.name][k]) for p in parameters}
        in_si = {p.name: float(p.factor) * point[p.name] for p in parameters}
        for s in (0.3 + 0.7j, 2.0j, 40.0j):
            wanted = BY_HAND[name](in_si, s)
            close.target(kit.transfer(model_of(name), s, point), wanted, close.MECHANISM)


@pytest.mark.parametrize("name", ORDERS)
def test_orders_and_bounds(name: str) -> None:
    model = model_of(name)
    assert (model.order, model.certificate.order_bound) == ORDERS[name]


def test_a_rolling_disk_is_stable_above_its_critical_rate() -> None:
    """Lean l of an upright disk: (A + m R^2) l'' = (m g (R - r) - W^2 C (C + m R^2)/A) l, from the
    equations of a disk (Neimark and Fufaev, section III.5, with r = 0) and a round edge that shifts the
    contact: the normal force m g acts r nearer to the center. So W^2 = g (R - r)/(3 R^2) is critical."""
    R = 0.4
    for m, r in ((2.0, 0.0), (1.9, 0.05), (2.1, 0.1)):
        A, C, critical = m * R**2 / 4, m * R**2 / 2, np.sqrt(G * (R - r) / (3 * R**2))
        for W in (0.0, 0.999 * critical, -1.001 * critical, 12.0):
            point = {"m": m, "W": W, "r": r}
            poles = np.linalg.eigvals(mbdlft.matrices_at(model_of("rolling_disk"), point).A)
            square = (m * G * (R - r) - W**2 * C * (C + m * R**2) / A) / (A + m * R**2)
            for pole in (np.sqrt(complex(square)), -np.sqrt(complex(square))):
                assert np.min(np.abs(poles - pole)) < 1e-6
            assert (np.max(poles.real) > 1e-3) == (abs(W) < critical)


def test_a_ball_goes_round_on_a_turntable_at_two_sevenths_of_its_rate() -> None:
    """From the table, a circle at a W turns at (1 - a) W, and its center at W; a = s/(1 + s)."""
    for W, s in ((2.0, 0.4), (5.0, 0.6)):
        poles = np.linalg.eigvals(mbdlft.matrices_at(model_of("ball_turntable"), {"W": W, "s": s}).A)
        for rate in (W, W / (1.0 + s)):
            assert min(np.min(np.abs(poles - 1j * rate)), np.min(np.abs(poles + 1j * rate))) < 1e-9
