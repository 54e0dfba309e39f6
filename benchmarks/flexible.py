"""Elastic scenes: verified against published results and finite elements, then counted and timed.

    python -m benchmarks.flexible [--search SECONDS] [--write docs/flexible.md]

Repetitions of the source are those of J. A. Perez, PhD thesis (ISAE, Toulouse, 2016); the error is the
largest difference from the nonlinear equations, trimmed and linearized again.
"""

import argparse
import textwrap
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import mbdlft
from benchmarks.arm import write_between
from benchmarks.assumed_modes import frequencies as assumed
from benchmarks.cases import beams
from benchmarks.cases import flexible as data
from benchmarks.cases.superelement import superelement_matrix
from mbdlft.pipeline.models import SEARCH, build

_SAMPLES = 100
_WHOLE = 20  # elements of an appendage; with more, one of the four by symmetry


@dataclass(frozen=True)
class Check:
    """One promise: the largest relative error, and what was promised."""

    what: str
    error: float
    promised: float


@dataclass(frozen=True)
class Count:
    """One model: repetitions of the source and of ours."""

    case: str
    states: int
    source: str
    ours: int
    bound: str
    error: float
    seconds: float


def worst(found: object, expected: object) -> float:
    """Largest relative difference."""
    return float(np.max(np.abs(np.asarray(found) / np.asarray(expected) - 1.0)))


def checks() -> list[Check]:
    """All published numbers, and direct finite elements."""
    model = lambda scene: mbdlft.to_lft(scene, search=0.0)  # noqa: E731
    spacecraft = []
    for elements, table in data.SPACECRAFT.items():
        pair = (data.clamped_appendage(elements), data.spacecraft(elements, 1))
        modes = np.array([data.frequencies(model(scene))[:3] for scene in pair]).T.ravel()
        spacecraft.append(worst(modes, table))
    whole = [
        worst(
            data.frequencies(model(data.spacecraft(elements)))[:12],
            np.repeat(data.SPACECRAFT[elements], [3, 1, 3, 1, 3, 1]),
        )
        for elements in data.SPACECRAFT
        if elements < _WHOLE
    ]
    arm = [worst(data.frequencies(model(data.arm(a)))[:4], data.ARM[a]) for a in data.ARM]
    length = model(data.counted("length"))
    hertz = [data.frequencies(length, L=L)[0] / (2.0 * np.pi) for L in data.LENGTHS]
    mast = data.frequencies(model(data.mast()))[:3]
    return [
        Check("rotatory spacecraft, 24 frequencies of table 6.4", max(spacecraft), 2e-5),
        Check("the same with all four appendages, 4, 9, 14 elements", max(whole), 2e-5),
        Check(
            "rival method, assumed modes in 50 digits, 18 frequencies of table 6.4",
            max(worst(assumed(n), data.ASSUMED[n]) for n in data.ASSUMED),
            2e-5,
        ),
        Check("two-link arm, 12 frequencies of table 6.6", max(arm), 1e-4),
        Check("beam of 1.05 and 1.5 m, table 6.2", worst(hertz, [*data.LENGTHS.values()]), 1e-3),
        Check("LFT at 100 random lengths, direct finite elements", frozen(length), 1e-8),
        Check("observatory, three modes of section 9.2", worst(mast, data.MAST), 3e-3),
    ]


def frozen(model: mbdlft.LFTModel) -> float:
    """Frequencies of the LFT of one beam at random lengths against the superelement itself."""
    per_length = data.STRIP["density"] * data.STRIP["thickness"] * data.STRIP["width"]
    bending = data.STRIP["modulus"] * data.STRIP["width"] * data.STRIP["thickness"] ** 3 / 12.0
    lengths = mbdlft.random(model.parameters, _SAMPLES)["L"]
    return max(
        worst(
            data.frequencies(model, L=float(length)),
            beams.clamped(beams.superelement(float(length), bending, per_length)),
        )
        for length in lengths
    )


def counts(search: float) -> list[Count]:
    """Repetitions, with the proved bound; that of one length is computed in exact arithmetic."""
    found = []
    for name, source in data.REPETITIONS.items():
        built = build(data.counted(name), search)
        certificate = built.model.certificate
        bound = str(certificate.order_bound)
        if name == "length":
            bound = f"{mbdlft.exact_lower_bound(superelement_matrix(lift=False))['L']} (exact)"
        more = "> " if name == "section and length" else ""
        found.append(
            Count(
                name,
                len(built.model.states),
                f"{more}{source}",
                built.model.order,
                bound,
                certificate.max_relative_error,
                sum(built.seconds.values()),
            )
        )
        assert built.model.order <= source, name
    return found


def tables(search: float) -> str:
    """All tables, once every promise is kept."""
    promises = checks()
    for check in promises:
        assert check.error <= check.promised, check
    lines = ["| what | largest relative error | promised |", "|---|---|---|"]
    lines += [f"| {c.what} | {c.error:.1e} | {c.promised:.0e} |" for c in promises]
    lines += ["", "| case | states | source | ours | bound | error | seconds |"]
    lines += ["|---|---|---|---|---|---|---|"]
    lines += [
        f"| {c.case} | {c.states} | {c.source} | {c.ours} | {c.bound} | {c.error:.1e} | {c.seconds:.1f} |"
        for c in counts(search)
    ]
    built = build(data.large(), 0.0)
    seconds = ", ".join(f"{name} {value:.1f}" for name, value in built.seconds.items())
    lines += [
        "",
        f"A scene with {len(built.model.states)} states and {len(built.model.parameters)} parameters, "
        f"without search: {built.model.order} repetitions, error "
        f"{built.model.certificate.max_relative_error:.1e}; seconds: {seconds}.",
    ]
    return "\n".join(lines) + "\n"


def main() -> None:
    """Print the tables, or write them into a page between its marks."""
    parser = argparse.ArgumentParser(description=textwrap.dedent(__doc__ or ""))
    parser.add_argument("--search", type=float, default=SEARCH)
    parser.add_argument("--write", type=Path)
    options = parser.parse_args()
    text = tables(options.search)
    if options.write is None:
        print(text)
        return
    write_between(options.write, text)


if __name__ == "__main__":
    main()
