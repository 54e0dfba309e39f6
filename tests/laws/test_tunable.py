"""Laws of tunable gains: closed with them the plant is the model again; names, bounds, what is proved."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

import mbdlft
from mbdlft import matrices_at, to_delta, tunable
from tests.close import CLOSED_FORM, exact, roundoff, target
from tests.laws.test_ports import values_of
from tests.laws.test_systems import ARM

NAMES = [p.name for p in ARM.parameters]


def closed(found: mbdlft.TunablePlant, values: dict[str, float], gains: list[float]) -> np.ndarray:
    """[A B ; C D] with w = delta z closed by hand, at values of the other parameters."""
    inner = values_of(found.plant, values)
    repeated = [d for gain, d in zip(found.gains, gains, strict=True) for _ in range(gain.repetitions)]
    k = len(repeated)
    n = inner.shape[0] - k
    m = inner.shape[1] - k
    loop = np.linalg.solve(np.eye(k) - inner[n:, m:] * repeated, inner[n:, :m])
    return inner[:n, :m] + inner[:n, m:] * repeated @ loop


@settings(max_examples=15, deadline=None)
@given(st.lists(st.sampled_from(NAMES), min_size=1, unique=True), st.integers(0, 2**32 - 1))
def test_closed_with_its_gains_the_plant_is_the_model(names: list[str], seed: int) -> None:
    found = tunable(ARM, names)
    values = {name: float(v[0]) for name, v in mbdlft.random(ARM.parameters, 1, seed).items()}
    gains = [float(to_delta(g.parameter, values[g.name])) for g in found.gains]
    others = {name: value for name, value in values.items() if name not in names}
    for gain, delta in zip(found.gains, gains, strict=True):
        roundoff(gain.physical(delta), values[gain.name])
    target(closed(found, others, gains), values_of(ARM, values), CLOSED_FORM)


def test_plant_and_gains_say_what_they_are() -> None:
    found = tunable(ARM, ["theta1", "m3"])
    sizes = dict(ARM.lft.blocks)
    assert [(g.name, g.repetitions) for g in found.gains] == [
        ("theta1", sizes["theta1"]),
        ("m3", sizes["m3"]),
    ]
    assert found.gains[1].bounds == (-1.0, 1.0)
    new = [name for gain in found.gains for name in gain.inputs]
    assert [s.name for s in found.plant.inputs] == [*(s.name for s in ARM.inputs), *new]
    assert new[0] == "theta1.w.1"
    assert found.gains[0].outputs[0] == "theta1.z.1"
    assert found.plant.order == ARM.order - sizes["theta1"] - sizes["m3"]
    assert found.plant.trim.lft is None  # the torques depend on them
    exact(found.gains[1].physical(0.0), found.gains[1].parameter.nominal)
    # a nominal gain of zero leaves the nominal model
    n = len(ARM.states)
    exact(matrices_at(found.plant, {}).A, matrices_at(ARM, {}).A)
    assert found.plant.A.shape == (n, n)


def test_what_is_proved_of_the_others_stays() -> None:
    found = tunable(ARM, ["theta1"]).plant.certificate
    left = [k for k, name in enumerate(NAMES) if name != "theta1"]
    assert found.lower_bound == tuple(ARM.certificate.lower_bound[k] for k in left)
    assert found.order_bound <= sum(found.order)


def test_design_parameters_are_the_default() -> None:
    k = mbdlft.Parameter("k", 40.0, low=30.0, high=60.0, role="design")
    m = mbdlft.Parameter("m", 3.0, percent=20)
    cart = mbdlft.realize([["0", "1", "0"], ["-k/m", "-0.4/m", "1/m"], ["1", "0", "0"]], [k, m], states=2)
    found = tunable(cart)
    assert [(g.name, g.repetitions) for g in found.gains] == [("k", 1)]
    assert [p.name for p in found.plant.parameters] == ["m"]
    target(closed(found, {"m": 2.5}, [1.0]), values_of(cart, {"k": 60.0, "m": 2.5}), CLOSED_FORM)


def test_a_trim_without_the_parameter_stays() -> None:
    """The torques of the arm hang on no damping."""
    scene = mbdlft.load_scene("scenarios/two_link_arm.toml")
    damped = scene.model_copy(
        update={
            "parameters": (*scene.parameters, mbdlft.Parameter("d", 1.0, percent=50, unit="N m s")),
            "joints": (scene.joints[0].model_copy(update={"damping": "d"}), *scene.joints[1:]),
        }
    )
    model = mbdlft.to_lft(damped, search=0.0)
    plant = tunable(model, ["d"]).plant
    target(mbdlft.trim_at(plant, {"theta1": 60.0}), mbdlft.trim_at(model, {"theta1": 60.0}), CLOSED_FORM)
