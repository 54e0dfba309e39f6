"""The commands `response`, `poles`, `simulate`: a model at nominal and at samples, and motions."""

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from mbdlft import analyze, base, dae, multibody, pipeline, show
from mbdlft import system as systems
from mbdlft.base.array import Array, ArrayLike
from mbdlft.base.errors import AnalysisError
from mbdlft.cli import options, rooms
from mbdlft.cli.output import print_files, print_json, print_table, progress_of, say, write_text

KINDS = ("sigma", "bode", "nyquist", "nichols", "step", "poles", "order", "trim")  # of figures
WITH_WORST = KINDS[:5]  # kinds that show a worst case
OVER = ("poles", "trim")  # kinds that may be over one parameter
_SHORT = 8  # rows of the table of poles that comes with a model


def response(
    source: options.Source,
    model: options.Model = None,
    inputs: options.Inputs = None,
    outputs: options.Outputs = None,
    assignments: options.Values = None,
    frequencies: Annotated[
        list[float] | None,
        typer.Option("--at", help="Frequency (rad/s) at which to print values; may be repeated."),
    ] = None,
    samples: options.Samples = 300,
    seed: options.Seed = 0,
    figure: options.Figure = None,
    kind: Annotated[
        str,
        typer.Option(help="Of the figure: sigma, bode, nyquist, nichols, step, poles, order or trim."),
    ] = "sigma",
    width: options.FigureWidth = None,
    as_json: options.AsJson = False,
) -> None:
    """Print norms, the worst of random samples, and values at frequencies."""
    _check(figure, kind, frequencies)
    system = chosen_channels(options.load_system(source, model), outputs, inputs)
    point = options.values_of(assignments, _known(system))
    points = [_gains(system, "as set" if point else "nominal", point)]
    worst = _worst(system, samples, seed)
    if worst is not None:
        points.append(_gains(system, f"worst of {samples} samples", worst))
    values = _values_at(system, point, samples, seed, frequencies or [])
    try:
        if as_json:
            names = {key: [s.name for s in getattr(system, key)] for key in ("inputs", "outputs")}
            print_json({"name": system.name, **names, "points": points, "values": values})
        else:
            _print(system, points, values)
    finally:  # a figure that fails takes nothing away
        if figure is not None:
            with options.on_paper(width):
                draw(kind, figure, system, seed)
    if figure is not None and not as_json:
        say(f"figure: {figure}")


def draw(
    kind: str, figure: Path, system: "systems.System", seed: int = 0, over: str | None = None, **more: Any
) -> None:
    """Draw a figure of one of the `KINDS`, if need be over a parameter, or with a worst case."""
    if kind in OVER:
        {"poles": show.save_pole_map, "trim": show.save_trims}[kind](figure, system, over, seed)
    elif kind == "order":
        show.save_orders(figure, system)
    else:
        getattr(show, f"save_{'singular_values' if kind == 'sigma' else kind}")(
            figure, system, seed, **more
        )


def _known(system: "systems.System") -> str:
    """What may be set, at the end of a message."""
    return f" Parameters: {', '.join(system.parameters.names) or 'none'}."


def chosen_channels(
    system: "systems.System", outputs: list[str] | None, inputs: list[str] | None
) -> "systems.System":
    """The system with some of its outputs and inputs; all states stay."""
    chosen = rooms.modes.chosen
    rows = chosen(system.name, "output", outputs, system.outputs, "responses")
    columns = chosen(system.name, "input", inputs, system.inputs, "responses")
    if not (outputs or inputs):
        return system
    return system[[system.outputs[k].name for k in rows], [system.inputs[k].name for k in columns]]


def _check(figure: Path | None, kind: str, frequencies: list[float] | None) -> None:
    """Raise an error for what is known to be wrong before the work."""
    if kind not in KINDS:
        raise AnalysisError(f"--kind {kind}: expected one of {', '.join(KINDS)}.")
    for omega in frequencies or []:
        if not 0.0 < omega < math.inf:
            raise AnalysisError(
                f"--at {omega:g}: expected a positive finite frequency (rad/s), such as 1.5."
            )
    options.check_paths(None, figure)


def _gains(system: "systems.System", what: str, values: Mapping[str, float]) -> dict[str, Any]:
    """Norms at one point, and the highest peak, which is there where norms are infinite, too."""
    hinf = analyze.hinf_norm(system, values)
    try:
        norm = analyze.h2_norm(system, values)
        h2 = {"value": float(norm.value[0]), "reason": norm.reason[0]}
    except AnalysisError as error:  # what is known of the peak is worth printing
        h2 = {"value": math.nan, "reason": str(error)}
    omega, largest = _largest(system, values)
    k = int(np.argmax(rooms.frequency.peaks(largest)[0]))
    bounds = {name: float(getattr(hinf, name)[0]) for name in ("lower", "upper", "frequency")}
    return {
        "what": what,
        "values": dict(values),
        "hinf": {**bounds, "reason": hinf.reason[0]},
        "h2": h2,
        "peak": {"gain": float(largest[0, k]), "frequency": float(omega[0, k])},
    }


def _worst(system: "systems.System", samples: int, seed: int) -> dict[str, float] | None:
    """The sample of the highest peak; nothing without parameters or samples."""
    if not (samples and system.parameters):
        return None
    values = base.random(system.parameters, samples, seed)
    k = int(np.argmax(np.max(rooms.frequency.peaks(_largest(system, values)[1]), axis=1)))
    return {name: float(column[k]) for name, column in values.items()}


def _largest(system: "systems.System", values: Mapping[str, ArrayLike]) -> tuple[Array, Array]:
    """Frequencies (N, F) of samples, and the largest singular values at them."""
    omega = analyze.response_frequencies(system, values)
    response = analyze.frequency_response(system, values, omega)
    return omega, analyze.singular_values(response)[..., 0]


def _values_at(
    system: "systems.System", point: dict[str, float], samples: int, seed: int, frequencies: list[float]
) -> list[dict[str, Any]]:
    """Size and phase of each channel at frequencies, and the range of the size over samples."""
    if not frequencies:
        return []
    middle = analyze.frequency_response(system, point, frequencies)[0]
    ranges = None
    if samples and system.parameters:
        drawn = base.random(system.parameters, samples, seed)
        sizes = np.abs(analyze.frequency_response(system, drawn, frequencies))
        ranges = np.min(sizes, axis=0), np.max(sizes, axis=0)
    return [
        {
            "frequency": omega,
            "input": u.name,
            "output": y.name,
            "unit": f"{y.unit} / ({u.unit})",
            "size": float(abs(middle[f, i, j])),
            "phase_deg": float(np.degrees(np.angle(middle[f, i, j]))),
            "lowest": None if ranges is None else float(ranges[0][f, i, j]),
            "highest": None if ranges is None else float(ranges[1][f, i, j]),
        }
        for f, omega in enumerate(frequencies)
        for i, y in enumerate(system.outputs)
        for j, u in enumerate(system.inputs)
    ]


def _print(system: "systems.System", points: list[dict[str, Any]], values: list[dict[str, Any]]) -> None:
    """Tables, and sentences on what is infinite."""
    rows = []
    for point in points:
        hinf, h2, peak = point["hinf"], point["h2"], point["peak"]
        numbers = [*(hinf[name] for name in ("lower", "upper", "frequency")), h2["value"]]
        numbers += [peak["gain"], peak["frequency"]]
        rows.append((point["what"], *(f"{number:.7g}" for number in numbers)))
    print_table(
        f"{system.name}: gains ({rooms.frequency.gain_unit(system)})",
        "at | H-infinity > | to at most > | at (rad/s) > | H2 > | peak > | at (rad/s) >",
        rows,
    )
    for point in points:
        how = "not known" if math.isnan(point["h2"]["value"]) else "infinite"
        for norm, key, verdict in (("H-infinity", "hinf", "infinite"), ("H2", "h2", how)):
            if point[key]["reason"]:
                say(f"{point['what']}: {norm} norm {verdict}: {point[key]['reason']}")
    for point in points[1:]:
        at = ", ".join(f"{name} = {value:.6g}" for name, value in point["values"].items())
        say(f"{point['what']}: {at}")
    if values:
        rows = []
        for each in values:
            span = ("" if each[k] is None else f"{each[k]:.4g}" for k in ("lowest", "highest"))
            start = f"{each['frequency']:g}", f"{each['input']} to {each['output']}"
            size = f"{each['size']:.6g}", f"{each['phase_deg']:.2f}"
            rows.append((*start, *size, *span, each["unit"]))
        headings = "at (rad/s) > | transfer | size > | phase (deg) > | lowest > | highest > | unit"
        print_table("values", headings, rows)


def poles(
    source: options.Source,
    model: options.Model = None,
    assignments: options.Values = None,
    samples: options.Samples = 300,
    seed: options.Seed = 0,
    prove: Annotated[
        float, typer.Option(min=0.0, help="Work (about seconds) for a proof of stability.")
    ] = 0.0,
    figure: options.Figure = None,
    over: Annotated[
        str | None, typer.Option(help="Parameter over which the figure shows the poles.")
    ] = None,
    width: options.FigureWidth = None,
    as_json: options.AsJson = False,
) -> None:
    """Print poles with their damping, transmission zeros, and whether values make it unstable."""
    options.check_paths(None, figure)
    if over is not None and figure is None:
        raise AnalysisError(f"--over {over}: expected a figure, too, such as -o poles.png.")
    system = options.load_system(source, model)
    point = options.values_of(assignments, _known(system))
    modes = analyze.damping_table(system, point)
    has_channels = bool(system.inputs and system.outputs)
    at_zero = analyze.zeros(system, point)[0].tolist() if has_channels else None
    with progress_of(system.name):
        verdict = analyze.check_stability(system, samples, seed, prove=prove)
    try:
        if as_json:
            data = {"name": system.name, "point": point, **modes_data(modes)}
            data["zeros"] = None if at_zero is None else [_parts(z) for z in at_zero]
            print_json({**data, "verdict": _verdict_data(verdict)})
        else:
            _print_poles(system, point, modes, at_zero, verdict)
    finally:  # a figure that fails takes nothing away
        if figure is not None:
            with options.on_paper(width):
                show.save_pole_map(figure, system, over, seed)
    if figure is not None and not as_json:
        say(f"figure: {figure}")


def _print_poles(
    system: "systems.System",
    point: dict[str, float],
    modes: "analyze.DampingTable",
    at_zero: list[complex] | None,
    verdict: "analyze.StabilityVerdict",
) -> None:
    """Tables and sentences."""
    where = ", ".join(f"{name} = {value:g}" for name, value in point.items()) or "nominal"
    if system.states:
        _print_modes(modes.rows(), f"{system.name}: poles at {where}", None)
    else:
        say(f"{system.name}: no states, so no poles")
    if at_zero:
        listed = ", ".join(_complex(z) for z in at_zero if z.imag >= 0.0)
        say(f"transmission zeros ({len(at_zero)}): {listed} rad/s")
    elif at_zero is not None:
        say("transmission zeros: none")
    say(str(verdict))


def _verdict_data(verdict: "analyze.StabilityVerdict") -> dict[str, Any]:
    """A verdict as plain data."""
    worst = verdict.worst_pole
    return {
        "sentence": str(verdict),
        "nominal": verdict.nominal,
        "counterexample": dict(verdict.counterexample) or None,
        "worst": dict(verdict.worst),
        "worst_pole": _parts(worst) if math.isfinite(worst.real) else None,
        "points": verdict.points,
        "proved": bool(verdict.proof),
    }


def print_poles(system: "systems.System") -> None:
    """Print a short table of the poles at nominal, and a line if it is not stable there."""
    if not system.states:
        return
    modes = analyze.damping_table(system)
    rows = modes.rows()
    _print_modes(rows, "poles at nominal", _SHORT)
    stability = modes.stability()
    if stability == "unstable":
        growing = [row for row in rows if row.time_constant < 0.0 and not row.on_axis]
        fastest = max(growing, key=lambda row: row.pole.real)
        say(
            f"UNSTABLE at nominal: {len(growing)} of {len(rows)} modes grow, the fastest by e in "
            f"{-fastest.time_constant:.4g} s"
        )
    elif stability == "marginal":
        say("not asymptotically stable at nominal: poles are on the axis")


def modes_data(modes: "analyze.DampingTable") -> dict[str, Any]:
    """Poles as plain data, for JSON."""
    numbers = ("natural_frequency", "frequency", "damping", "time_constant")
    poles = [
        {**_parts(row.pole), **{name: getattr(row, name) for name in numbers}, "on_axis": row.on_axis}
        for row in modes.rows()
    ]
    return {"poles": poles, "stability": modes.stability()}


def _print_modes(rows: "Sequence[analyze.ModeRow]", title: str, most: int | None) -> None:
    """A table of modes, equal ones in one row; the slowest ones if not all have room."""
    counts = Counter(tuple(cell.strip() for cell in rooms.modes.cells(row)) for row in rows)
    shown = list(counts.items())[:most]
    print_table(
        title,
        "pole (rad/s) | natural (rad/s) > | (Hz) > | damping > | time constant (s) > | multiplicity >",
        ((*texts, str(count) if count > 1 else "") for texts, count in shown),
    )
    if most is not None and len(counts) > most:
        say(f"and {len(counts) - most} faster ones: mbdlft poles lists all")


def _parts(number: complex) -> dict[str, float]:
    return {"real": number.real, "imag": number.imag}


def _complex(number: complex) -> str:
    """A real number, or a pair."""
    return f"{number.real:.6g}" + (f" +- {number.imag:.6g}j" if number.imag else "")


_INPUT = (
    "NAME=number, held from the beginning; NAME=step:SIZE@TIME; or NAME=sine:SIZE:RATE with the rate in "
    "rad/s, such as shoulder.torque=step:1@0.5."
)

_START = "state=number, such as shoulder.angle=0.1."


def simulate(
    scene_file: Annotated[Path, typer.Argument(help="Scene, a TOML file.")],
    assignments: options.Values = None,
    inputs: Annotated[
        options.Texts,
        typer.Option("--input", help="name=number, step:SIZE@TIME or sine:SIZE:RATE; may be repeated."),
    ] = None,
    initial: Annotated[
        options.Texts, typer.Option("--initial", help="state=number at the beginning; may be repeated.")
    ] = None,
    until: Annotated[float, typer.Option(help="Last time (s).")] = 10.0,
    steps: Annotated[int, typer.Option(min=1, max=options.MOST, help="Times after the first.")] = 400,
    amplitudes: Annotated[
        list[float] | None,
        typer.Option("--amplitude", help="Factor of inputs and initial states; may be repeated."),
    ] = None,
    plot: Annotated[Path | None, typer.Option("--plot", help="Figure of the outputs over time.")] = None,
    width: options.FigureWidth = None,
    output: Annotated[
        Path | None,
        typer.Option(
            "-o", "--output", help="Table of times, states and outputs of the last run, as CSV."
        ),
    ] = None,
    as_json: options.AsJson = False,
) -> None:
    """Simulate the motion of a scene, of any size, beside its linear model."""
    options.check_paths(None, plot, beside=(scene_file, output))
    factors = amplitudes or [1.0]
    _check_run(until, factors)
    values, scene = options.values_of(assignments), options.scene_in(scene_file)
    times = np.linspace(0.0, until, steps + 1)
    start = options.numbers_by_name("--initial", initial, _START, options.finite)
    model, rows = pipeline.to_lft(scene, search=0.0, prove=0.0), list[dict[str, Any]]()
    of_time = _of_time(inputs, times, scene, model)
    curves: dict[str, Array] = {}
    for factor in factors:
        moved, begun = ({name: factor * x for name, x in each.items()} for each in (of_time, start))
        run, beside = _both(scene, model, times, inputs=moved, parameters=values, initial=begun)
        rows.append({"amplitude": factor, **_compared(run, beside)})
        label = f" at {factor:g}" if len(factors) > 1 else ""
        curves |= {f"motion{label}": run.outputs, f"linear model{label}": beside}
    files: list[tuple[str, Path]] = []
    if plot is not None:
        signals = [next(s for s in model.outputs if s.name == name) for name in run.output_names]
        with options.on_paper(width):
            show.save_motions(plot, scene.name, times, signals, curves)
        files.append(("figure", plot))
    if output is not None:
        write_text(output, _table(run))
        files.append(("motion", output))
    if as_json:
        print_json(
            {"name": scene.name, "until": until, "runs": rows, "files": [str(f) for _, f in files]}
        )
        return
    units = {s.name: s.unit for s in model.outputs}
    table = [_of_motion(row, units) for row in rows]
    title = f"{scene.name}: outputs until {until:g} s"
    print_table(title, "amplitude > | largest > | unit | output | linear model off by >", table)
    print_files(*files, as_json=False)


def _compared(run: "dae.Simulation", beside: Array) -> dict[str, Any]:
    """The largest value of all outputs, which it is, and the error of the linear model relative to it.

    Where nothing moves, what is there is what the integrator leaves, and no error is relative to it.
    """
    sizes, off = (np.max(np.abs(x), axis=0).tolist() for x in (run.outputs, run.outputs - beside))
    size, name = max(zip(sizes, run.output_names, strict=True), default=(0.0, ""))
    moves = size > rooms.simulation.TOLERANCE
    return {"largest": size, "output": name, "linear_error": max(off) / size if moves else 0.0}


def _of_motion(row: Mapping[str, Any], units: Mapping[str, str]) -> tuple[str, ...]:
    """The texts of a row of the table."""
    name, numbers = row["output"], (f"{row['amplitude']:g}", f"{row['largest']:.4g}")
    return (*numbers, units.get(name, ""), name, f"{row['linear_error']:.2g}")


def _both(
    scene: "multibody.Scene", model: "systems.LFTModel", times: Array, **asked: Any
) -> tuple["dae.Simulation", Array]:
    """The motion, and its outputs by the model; forces of constraints are of the model only."""
    run, linear = (dae.simulate(each, times, **asked) for each in (scene, model))
    return run, linear.outputs[:, [linear.output_names.index(name) for name in run.output_names]]


def _of_time(
    texts: list[str] | None, times: Array, scene: "multibody.Scene", model: "systems.LFTModel"
) -> dict[str, Array]:
    """Values (N,) of inputs; a motion that is one has its rate and acceleration, if they are felt."""
    every = options.by_name("--input", texts, _INPUT, lambda text: _signal(text, times), AnalysisError)
    values, felt = {name: x[0] for name, x in every.items()}, {s.name for s in model.inputs}
    moved = (joint for joint in scene.joints if getattr(joint, "imposed", False) == "motion")
    for name, *rates in ([s.of(j.name).name for s in f.measures] for j in moved for f in j.freedoms):
        for rate, x in zip(rates, every.get(name, [])[1:], strict=False):
            if rate in felt:
                values.setdefault(rate, x)
    return values


def _table(run: "dae.Simulation") -> str:
    """Times, states and outputs as text with commas."""
    lines = [",".join(["time", *run.state_names, *run.output_names])]
    whole = np.column_stack([run.times, run.states, run.outputs])
    return "\n".join([*lines, *(",".join(f"{x:.17g}" for x in row) for row in whole)]) + "\n"


def _check_run(until: float, factors: list[float]) -> None:
    """Raise an error for numbers that are none."""
    if not 0.0 < until < math.inf:
        raise AnalysisError(f"--until {until:g}: expected a positive time (s).")
    if not all(map(math.isfinite, factors)):
        raise AnalysisError(f"--amplitude: expected finite numbers, got {factors}.")


def _signal(text: str, times: Array) -> Array:
    """Values of an input at times, of its rate and of its rate's (3, N); a ValueError if it is none."""
    kind, colon, size_text = text.partition(":")
    if not colon or kind == "step":
        size, _, begin = (size_text if colon else text).partition("@")
        start, height = options.finite(begin or "0"), options.finite(size)
        return np.where(times >= start, height, 0.0) * [[1.0], [0.0], [0.0]]
    if kind == "sine":
        height, rate = map(options.finite, size_text.split(":"))
        quarters = rate * times + 0.5 * np.pi * np.arange(3)[:, None]
        return np.asarray(height * rate ** np.arange(3)[:, None] * np.sin(quarters))
    raise ValueError(text)
