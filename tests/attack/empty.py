"""Models without states, inputs, outputs or parameters, in every combination, through all that takes one.

What comes is an answer without numbers that are not numbers, or an error of the package.
"""

import warnings
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from typer.testing import CliRunner

import mbdlft
from mbdlft import LFTModel, MbdlftError, Parameter
from mbdlft.cli.commands import app
from mbdlft.dae import DaeDraft

KINDS = ("states", "inputs", "outputs", "parameters")
FIGURES = ("singular_values", "bode", "nyquist", "nichols", "pole_map", "step", "orders", "trims", "mu")
WORST = ("real part", "damping", "disk margin", "H2 norm")
SUFFIXES = (".mat", ".c", ".jl", ".mo", ".fmu")
COMMANDS = (
    *("show", "poles", "response", "margin", "wcgain", "worst --of damping", "worst --of disk-margin"),
    *("verify", "report -o r.html", "sweep --random 3 -o s.h5", "view -o v.html", "trim"),
    *("simulate", "wcgain --rate p=0.1", "margin --rate p=inf", "linearize"),
)


def attack(seed: int, folder: Path) -> str:
    """Everything that is done with one model, of a matrix or, by seed & 32, of equations.

    With seed & 16 the command line is asked.
    """
    missing = [kind for k, kind in enumerate(KINDS) if seed >> k & 1]
    model = (of_equations if seed & 32 else without)(missing)
    answers = 0
    for what, asked in (commands if seed & 16 else calls)(model, folder):
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("error", RuntimeWarning)
                asked()
            answers += 1
        except MbdlftError:
            continue
        except Exception as error:
            raise AssertionError(f"without {missing}: {what}: {error!r}") from error
    assert answers
    return "answered"


def without(missing: list[str]) -> LFTModel:
    """x'' + x' + p x = u with y = x + p u, or y = p u, without what is missing."""
    p = Parameter("p", 1.0, low=0.5, high=1.5)
    rows = [["p"]] if "states" in missing else [["0", "1", "0"], ["-p", "-1", "1"], ["1", "0", "p"]]
    text = [
        [entry.replace("p", "1" if "parameters" in missing else "p") for entry in row] for row in rows
    ]
    own = [] if "parameters" in missing else [p]
    states = len(rows) - 1
    model = mbdlft.realize(text, own, states=states, inputs=["u"], outputs=["y"], name="empty")
    selected: LFTModel = model[
        ("outputs" not in missing and "y") or [], ("inputs" not in missing and "u") or []
    ]
    return selected


def of_equations(missing: list[str]) -> LFTModel:
    """x' = u - p x with y = x + p u, or y = p u, as equations, without what is missing."""
    d = DaeDraft("empty")
    p = 1 if "parameters" in missing else d.parameter(Parameter("p", 1.0, low=0.5, high=1.5))
    u = 0 if "inputs" in missing else d.input("u")
    y = d.variable("y")
    if "states" in missing:
        d.equation(y, equals=p * u)
    else:
        x = d.variable("x")
        d.equation(d.der(x), equals=u - p * x)
        d.equation(y, equals=x + p * u)
    if "outputs" not in missing:
        d.output("y")
    mbdlft.delta_theta(d.dae())
    return mbdlft.linearize_dae(d.dae())


def calls(model: LFTModel, folder: Path) -> Iterator[tuple[str, Callable[[], Any]]]:
    """Functions and exports, each with its name."""
    points = mbdlft.random(model.parameters, 3, 1)
    omega, times = np.array([0.0, 1.0]), np.linspace(0.0, 1.0, 3)
    inputs, outputs = ([signal.name for signal in signals] for signals in (model.inputs, model.outputs))
    one = {"work": 0.2}
    rates = {p.name: 0.1 for p in model.parameters}
    state = {s.name: 1.0 for s in model.states}
    functions: dict[str, Callable[..., Any]] = {
        "at": lambda m: m.at(),
        "matrices_at": lambda m: mbdlft.matrices_at(m, points),
        "computed_by": lambda m: mbdlft.system.computed_by(m, 5),
        "trim_at": lambda m: mbdlft.trim_at(m, points),
        "poles": mbdlft.analyze.poles,
        "zeros": mbdlft.analyze.zeros,
        "damping_table": mbdlft.damping_table,
        "check_stability": lambda m: mbdlft.check_stability(m, prove=0.2),
        "pole_gradients": mbdlft.analyze.pole_gradients,
        "frequency_response": lambda m: mbdlft.frequency_response(m, points, omega),
        "singular_values": lambda m: mbdlft.analyze.singular_values(
            mbdlft.frequency_response(m, points, omega)
        ),
        "response_frequencies": lambda m: mbdlft.analyze.response_frequencies(m, points),
        "unbounded_frequencies": lambda m: mbdlft.analyze.unbounded_frequencies(m, points),
        "hinf_norm": lambda m: mbdlft.analyze.hinf_norm(m, points),
        "h2_norm": lambda m: mbdlft.analyze.h2_norm(m, points),
        "step_response": lambda m: mbdlft.analyze.step_response(m, points, times),
        "step_response, times": mbdlft.analyze.step_response,
        "impulse_response": lambda m: mbdlft.analyze.impulse_response(m, points, times),
        "initial_response": lambda m: mbdlft.analyze.initial_response(m, state, points, times),
        "response_times": mbdlft.analyze.response_times,
        "disk_transfer": mbdlft.analyze.disk_transfer,
        "structured_singular_value": lambda m: mbdlft.analyze.structured_singular_value(m, omega),
        "mu_bands": lambda m: mbdlft.analyze.mu_bands(m, 0.1, 10.0),
        "with_program": mbdlft.batch.with_program,
        "compile": lambda m: mbdlft.batch.compile(m)(points),
        "truncate": lambda m: mbdlft.system.truncate(m, 0.1),
        "invert_channels": lambda m: mbdlft.system.invert_channels(m, inputs),
        "tunable": lambda m: mbdlft.system.tunable(m, []),
        "series": lambda m: mbdlft.series(m, m),
        "append": lambda m: mbdlft.append(m, m),
        "feedback": lambda m: mbdlft.feedback(m, np.ones((len(m.inputs), len(m.outputs)))),
        "connect": lambda m: mbdlft.connect([m], [], inputs=inputs, outputs=outputs),
        "operators": lambda m: (m + m, m - m, 2.0 * m, m * m, -m),
        "with_range": lambda m: m.with_range(**{p.name: (0.9, 1.1) for p in m.parameters}),
        "print": lambda m: (str(m), repr(m), m._repr_html_() if hasattr(m, "_repr_html_") else ""),
        "casadi_function": lambda m: mbdlft.export.casadi_function(m)(),
        "frequency_data": lambda m: mbdlft.export.frequency_data(m, points, omega[1:]),
        "dataset": lambda m: mbdlft.export.dataset(m, points, omega),
        "lpv_grid": lambda m: mbdlft.export.lpv_grid(m, 2),
        "report": lambda m: mbdlft.show.model_report(m).save(folder / "r.html"),
        "scene_of": mbdlft.show.scene_of,
        "save": lambda m: mbdlft.save(folder / "a.h5", m) and mbdlft.load(folder / "a.h5"),
        "sweep": lambda m: mbdlft.sweep(m, mbdlft.batch.RandomSamples(3, 1), folder / "s.h5"),
        "load_sweep": lambda m: mbdlft.load_sweep(folder / "s.h5"),
        "tune": lambda m: mbdlft.tune([m], [mbdlft.synthesis.pole_goal(decay=0.1)], []),
        "simulate": lambda m: mbdlft.dae.simulate(m, times),
    }
    for name, function in functions.items():
        yield name, partial(function, model)
    bounds: dict[str, Callable[..., Any]] = {
        "robust_stability": mbdlft.robust_stability,
        "worst_case_gain": mbdlft.worst_case_gain,
        "robust_performance": mbdlft.robust_performance,
        "moving stability": partial(mbdlft.robust_stability, rates=rates),
        "moving gain": partial(mbdlft.worst_case_gain, rates=rates),
        "fixed": partial(mbdlft.robust_stability, fixed=list(rates)),
        **{what: partial(mbdlft.worst_case, what=what) for what in WORST},
    }
    for name, function in bounds.items():
        yield name, partial(_proved, function, one, model, folder)
    for name in (*FIGURES, "growth"):
        yield name, partial(getattr(mbdlft.show, f"save_{name}"), folder / f"{name}.png", model)
    for suffix in SUFFIXES:
        yield suffix, partial(mbdlft.export.export_model, folder / f"x{suffix}", model)
    for suffix in (".mat", ".csv", ".npz"):
        yield f"grid {suffix}", partial(mbdlft.export.export_model, folder / f"g{suffix}", model, 2)


def _proved(function: Callable[..., Any], options: Any, model: LFTModel, folder: Path) -> None:
    """Bounds, which are verified, stored, and read again."""
    bounds = function(model, **options)
    assert not bounds.lower > bounds.upper, bounds
    assert not np.isnan([bounds.lower, bounds.upper]).any(), bounds
    if bounds.proof is not None:
        assert mbdlft.verify(model, bounds) == "", bounds
    mbdlft.save_analysis(folder / "b.h5", model, bounds)
    mbdlft.load_analysis(folder / "b.h5")


def commands(model: LFTModel, folder: Path) -> Iterator[tuple[str, Callable[[], Any]]]:
    """Commands for the archive of the model, each with its words; and as JSON where there is that."""
    archive = folder / "m.h5"
    mbdlft.save(archive, model)
    for words in [*COMMANDS, *(f"export -o x{suffix}" for suffix in SUFFIXES)]:
        yield words, partial(_ran, words, archive, folder)


def _ran(words: str, archive: Path, folder: Path) -> None:
    name, *options = words.split()
    options = [str(folder / o) if options[k - 1] == "-o" else o for k, o in enumerate(options)]
    result = CliRunner().invoke(app, [name, str(archive), *options])
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    assert "Traceback" not in result.output, result.output
