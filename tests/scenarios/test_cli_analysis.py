"""The commands margin, wcgain and verify."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import scipy.sparse
from scipy.io import savemat

import mbdlft
from mbdlft.show import save_growth
from tests.laws.test_margins import random_loop_with_channels
from tests.scenarios.commands import Call, Output

KEYS = {"lower", "upper", "frequency", "worst", "proved", "seconds"}


@pytest.fixture
def archive(tmp_path: Path) -> Path:
    mbdlft.save(tmp_path / "a.h5", random_loop_with_channels())
    return tmp_path / "a.h5"


def cart() -> mbdlft.LFTModel:
    own = [mbdlft.Parameter("k", 2.0, low=1.0, high=3.0)]
    matrix = [["0", "1", "0"], ["-k", "-0.4", "1"], ["1", "0", "0"]]
    return mbdlft.realize(matrix, own, states=2, inputs=["f"], outputs=["x"], name="matrix")


@pytest.fixture
def small(tmp_path: Path) -> Path:
    """An archive of a cart whose stiffness alone is a parameter."""
    mbdlft.save(tmp_path / "a.h5", cart())
    return tmp_path / "a.h5"


def test_a_nominal_model_on_the_edge_is_called_so(tmp_path: Path, call: Call) -> None:
    damping = mbdlft.Parameter("c", 1e-8, low=-1.0, high=1.0)
    matrix = [["0", "1", "0"], ["-2", "-c", "1"], ["1", "0", "0"]]
    model = mbdlft.realize(matrix, [damping], states=2, inputs=["f"], outputs=["x"], name="edge")
    mbdlft.save(tmp_path / "a.h5", model)
    _, out, _ = call("margin", str(tmp_path / "a.h5"))
    assert "nominal is on the edge of stability: 1e-08 of the ranges brings a pole to the axis" in out
    _, out, _ = call("worst", str(tmp_path / "a.h5"), "--of", "damping")
    assert "edge, smallest damping:\nnothing is proved" in out


def test_margin_gain_and_their_proofs(archive: Path, call: Call, output: Output) -> None:
    out = output("margin", str(archive), "--json")
    found = json.loads(out)
    assert set(found) >= KEYS
    assert found["proved"] is True
    assert 0.99 * found["upper"] <= found["lower"] <= found["upper"]
    assert set(found["worst"]) == {"k", "m"}
    out = output("wcgain", str(archive), "--input", "f", "--output", "x")
    assert "at most" in out
    assert "proved" in out
    out = output("verify", str(archive), "--json")
    assert [entry["proved"] for entry in json.loads(out)] == [True, True]
    code, out, _ = call("verify", str(archive))
    assert (code, out.count(": proved")) == (0, 2)


def test_a_controller_of_a_mat_file(small: Path, call: Call) -> None:
    none = np.zeros((0, 0))
    gain = np.array([[0.3]])
    K = small.parent / "K.mat"
    savemat(K, {"A": none, "B": np.zeros((0, 1)), "C": np.zeros((1, 0)), "D": gain})
    arguments = ("margin", str(small), "--controller", str(K), "--json")
    first, second = (json.loads(call(*arguments)[1]) for _ in range(2))
    assert first["lower"] == second["lower"]
    assert mbdlft.model_names(small) == ("matrix", "matrix with K")
    loop = mbdlft.feedback(cart(), gain)
    assert first["lower"] == mbdlft.robust_stability(loop).lower
    sparse = scipy.sparse.csc_array(gain)
    for wrong, text in (
        ({"A": none}, "B, C, D missing"),
        ({"A": none, "B": none, "C": none, "D": 1j * gain}, "of real numbers"),
        ({"A": "x", "B": none, "C": none, "D": gain}, "of real numbers"),
        ({"A": none, "B": none, "C": none, "D": {"a": 1}}, "of real numbers"),
        ({"A": none, "B": np.zeros((0, 1)), "C": np.zeros((1, 0)), "D": sparse}, ""),
    ):
        savemat(K, wrong)
        code, _, err = call(*arguments)
        assert code == (2 if text else 0)
        assert text in err
    K.write_bytes(b"")
    code, _, err = call(*arguments)
    assert code == 2
    assert "no .mat file that can be read" in err


def test_a_proof_that_is_none_ends_with_1(archive: Path, call: Call) -> None:
    code, _, err = call("verify", str(archive))
    assert code == 2
    assert "there is no analysis" in err
    call("margin", str(archive), "--work", "1e-6")
    code, out, _ = call("verify", str(archive))
    assert (code, out.count(": proved")) == (0, 1)  # by its norm
    loop, margin = mbdlft.load_analysis(archive)
    false = replace(margin, lower=2.1, upper=2.1)  # k = 0 at twice the ranges
    mbdlft.save_analysis(archive, loop, false)
    code, out, _ = call("verify", str(archive))
    assert (code, out.count(": proved")) == (1, 0)
    assert "NOT PROVED: the multipliers near" in out
    mbdlft.save_analysis(archive, loop, margin)
    call("worst", str(archive), "--of", "h2-norm", "--input", "f", "--output", "x")
    code, out, _ = call("verify", str(archive))
    assert (code, out.count(": proved")) == (1, 1)
    assert "NOT PROVED: there is no proof" in out


def test_rates_of_parameters(small: Path, call: Call, output: Output) -> None:
    arguments = ("margin", str(small), "--rate", "k=inf", "--gap", "0.5")
    out = output(*arguments)
    assert "also while they move at rates up to k inf per second: proved" in " ".join(out.split())
    assert "not stable at a motion of" in out
    found = json.loads(call(*arguments, "--no-save", "--json")[1])
    assert found["rates"] == {"k": None}
    assert 0.0 < found["lower"] <= found["upper"]
    code, out, _ = call("verify", str(small))
    assert (code, out.count(": proved")) == (0, 1)
    code, _, err = call("margin", str(small), "--rate", "k")
    assert code == 2
    assert "--rate k: expected NAME=BOUND" in err


def test_worst_cases(archive: Path, call: Call, output: Output) -> None:
    """Each property, stored beside the model; words for what is proved."""
    said = {
        "real-part": "rad/s for all values in the ranges: proved",
        "damping": "no pole is damped less than 0.10",
        "disk-margin": "the disk margin from f to x is at least",
        "h2-norm": "nothing is proved",
    }
    channel = ("--input", "f", "--output", "x")
    for what, words in said.items():
        arguments = ("worst", str(archive), "--of", what, *channel)
        out = output(*arguments)
        assert words in " ".join(out.split())
    found = json.loads(call(*arguments, "--json")[1])
    assert set(found) >= KEYS
    assert found["proved"] is False
    assert found["frequency"] is None
    assert mbdlft.analysis_names(archive) == (
        "matrix: largest real part",
        "matrix: smallest damping",
        "matrix: smallest disk margin",
        "matrix: worst-case H2 norm",
    )
    code, _, err = call("worst", str(archive), "--of", "speed")
    assert code == 2
    assert "real-part" in err


def test_fixed_parameters(archive: Path, call: Call, output: Output) -> None:
    arguments = ("margin", str(archive), "--fixed", "m")
    out = output(*arguments)
    assert "times the ranges, m in theirs: proved" in " ".join(out.split())
    found = json.loads(call(*arguments, "--json")[1])
    assert found["fixed"] == ["m"]
    assert found["lower"] <= 2.0 <= found["upper"] * (1.0 + 1e-9)  # k = 0
    code, out, _ = call("verify", str(archive))
    assert (code, out.count(": proved")) == (0, 1)


def test_figures_of_bounds(small: Path, call: Call) -> None:
    figure = small.with_name("f.png")
    for words in (("margin",), ("wcgain", "--input", "f", "--output", "x")):
        name, *more = words
        arguments = (name, str(small), *more, "--no-save", "--plot", str(figure))
        assert call(*arguments)[0] == 0
        assert figure.read_bytes().startswith(b"\x89PNG")
        figure.unlink()
    code, _, err = call("margin", str(small), "-o", "f.abc")
    assert code == 2
    assert "expected the ending" in err
    loop = cart()
    margin = mbdlft.robust_stability(loop, gap=0.1)
    for what in ("gain", "real part"):
        save_growth(figure, loop, what, "f", "x", sizes=[0.4, 0.8, 3.0], margin=margin, work=1.0)
        assert figure.read_bytes().startswith(b"\x89PNG")
        figure.unlink()
    with pytest.raises(mbdlft.AnalysisError, match="expected sizes that rise from above 0"):
        save_growth(figure, loop, sizes=[1.0, 0.5])
