"""Julia: the derivatives and outputs of a Delta-Theta form, behind the script of its linear part."""

from collections.abc import Sequence
from string import Template

from mbdlft.export.formulas import JULIA, Language, bodies_of, number
from mbdlft.export.julia import julia_text
from mbdlft.export.theta_parts import listed, places_of
from mbdlft.system.theta import DeltaThetaModel

_TEXT = r"""
# The nonlinear functions Theta:
#
#     rates, y, zeta = rates_at(x, u, Dict("NAME" => value))   # parameters that are not given are nominal
#     zeta, slopes = theta(omega)
#
$table

const INITIAL = $initial
const ZETA_AT_START = $start
const LOW, HIGH = $low, $high
const TABLES = [$tables]

# A table: breakpoints, values, slopes beyond the ends, slopes at the ends of the pieces of a cubic one.
function table_value(table, a, slope)
    b, v, ends, inner = table
    a < b[1] && return slope ? ends[1] : v[1] + ends[1] * (a - b[1])
    a > b[end] && return slope ? ends[2] : v[end] + ends[2] * (a - b[end])
    k = clamp(searchsortedlast(b, a), 1, length(b) - 1)
    h, rise = b[k+1] - b[k], v[k+1] - v[k]
    t = (a - b[k]) / h
    isempty(inner) && return slope ? rise / h : v[k] + t * rise
    left, right = h * inner[k][1] - rise, h * inner[k][2] - rise
    bend = (1 - t) * left - t * right
    slope && return (rise + (1 - 2t) * bend - t * (1 - t) * (left + right)) / h
    return v[k] + t * rise + t * (1 - t) * bend
end

function theta(omega)
    zeta, slopes = zeros($nz), zeros($nz, $no)
$bodies
    return zeta, slopes
end

# zeta = Theta(known + D zeta), by Newton's method with halved steps
function solve_theta(known, D, zeta)
    last, factor, more, from, step, scale = Inf, 1.0, 1, zeta, zeta, zeta
    for turn in 1:400
        omega = known + D * zeta
        at, slopes = theta(omega)
        if turn > 1 && factor > 1e-6
            now = norm((at - zeta) ./ scale)
            if !(now < last * (1 - 0.1factor)) && !(now <= 1e-12)
                factor /= 2
                zeta = from + factor * step
                continue
            end
        end
        scale = abs.(zeta) + abs.(at) + abs.(slopes) * (abs.(known) + abs.(D) * abs.(zeta))
        parts = (at - zeta) ./ max.(scale, 1e-300)
        all(isfinite, parts) || break
        if maximum(abs, parts) <= 1e-12
            more == 0 && return zeta, omega
            more -= 1
        end
        scale = max.(scale, 1.0)
        last, factor, from = norm((at - zeta) ./ scale), 1.0, zeta
        step = (I - slopes * D) \ (at - zeta)
        zeta = from + step
    end
    error("the values of Theta were not found near those that were given")
end

function rates_at(x, u, values = Dict{String,Float64}(); zeta = ZETA_AT_START, keywords...)
    A, B, C, D = matrices_at(values; keywords...)
    given = zeros(size(B, 2))
    given[$u] .= u
    given[$one] .= 1.0
    known = C[$omega, :] * x + D[$omega, :] * given
    zeta, omega = solve_theta(known, D[$omega, $zeta], zeta)
    for k in eachindex(omega)
        LOW[k] <= omega[k] <= HIGH[k] || error("Theta is evaluated outside of the range of argument $$k")
    end
    given[$zeta] = zeta
    return (rates = A * x + B * given, y = C[$y, :] * x + D[$y, :] * given, zeta = zeta)
end
"""


def theta_julia_text(model: DeltaThetaModel, stem: str, archive: str) -> str:
    """The script of a model; `archive` is the path of its archive from the folder of the script.

    Raises
    ------
    StructureError
        As `julia_text`; or the model has no functions.
    """
    places = places_of(model, "the Julia script")
    tables = [table for f in model.functions for table in f.tables]
    written = [
        f"({_vector(t.breakpoints)}, {_vector(t.values)}, {_vector([t.below, t.above])}, "
        f"Vector{{Float64}}[{', '.join(_vector(pair) for pair in t.slopes)}])"
        for t in tables
    ]
    behind = Template(_TEXT).substitute(
        table=listed(model, "#     "),
        initial=_vector(model.initial),
        start=_vector(model.zeta_at_start),
        low=_vector(places.low),
        high=_vector(places.high),
        tables=", ".join(written),
        nz=len(places.zeta),
        no=len(places.omega),
        bodies="\n".join(_bodies(model)),
        **{
            key: f"Int[{', '.join(str(k + 1) for k in getattr(places, key))}]"
            for key in ("u", "one", "zeta", "y", "omega")
        },
    )
    return julia_text(model.linear, stem, archive) + behind


def _vector(values: Sequence[float]) -> str:
    texts = [number(x).replace("inf", "Inf") for x in values]
    return f"Float64[{', '.join(texts)}]"


def _look_up(place: int, argument: str, is_slope: bool) -> str:  # noqa: FBT001
    return f"table_value(TABLES[{place + 1}], {argument}, {'true' if is_slope else 'false'})"


def _bodies(model: DeltaThetaModel) -> list[str]:
    lines = []
    language = Language(JULIA, lambda k: f"omega[{k + 1}]", _look_up)
    for row, (own, body) in enumerate(bodies_of(model, language), start=1):
        lines.append("    let")
        lines += [f"        {name} = {text}" for name, text in body.statements]
        lines.append(f"        zeta[{row}] = {body.value}")
        lines += [
            f"        slopes[{row}, {j + 1}] += {slope}"
            for j, slope in zip(own, body.slopes, strict=True)
        ]
        lines.append("    end")
    return lines
