# A model with its parameters left in: its archive is read and evaluated. Written by mbdlft.
#
#     include("<<stem>>.jl")
#     A, B, C, D = matrices_at(Dict("NAME" => value))    # physical values; the others are nominal
#     trim_at(Dict("NAME" => value))                     # what holds the equilibrium
#
# Needs Julia 1.6 or newer and the package HDF5.jl. ARCHIVE says where the archive is.
#
<<table>>

using HDF5
using LinearAlgebra

const ARCHIVE = normpath(joinpath(@__DIR__, <<archive>>))
const MODEL = <<model>>

# HDF5 is row-major and Julia is column-major: a matrix is read as its transpose
matrix(group, name) = permutedims(read(group[name]))
texts(group, name) = [String(rstrip(String(text), '\0')) for text in read(group[name])]

# Normalized deltas of physical values by name; the others are nominal, that is 0.
function deltas_of(group, values)
    names, units = texts(group, "name"), texts(group, "unit")
    substitutions, maps = texts(group, "substitution"), matrix(group, "map")
    low, high, reference = read(group["low"]), read(group["high"]), read(group["reference"])
    for name in keys(values)
        name in names || error("unknown parameter $name. Existing: $(join(names, ", "))")
    end
    deltas = zeros(length(names))
    for (k, name) in enumerate(names)
        haskey(values, name) || continue
        value = Float64(values[name])
        slack = 1e-9 * (high[k] - low[k])
        if !(low[k] - slack <= value <= high[k] + slack)
            error("$name = $value is outside its range [$(low[k]), $(high[k])] $(units[k])")
        end
        internal = value
        if substitutions[k] != "identity"
            radians = units[k] == "deg" ? value * (pi / 180) : value
            internal = tan((radians - reference[k]) / (substitutions[k] == "half-angle" ? 2 : 4))
        end
        b0, b1, a1 = maps[k, :]
        deltas[k] = (internal - b0) / (b1 - a1 * internal)
    end
    return deltas
end

# M22 + M21 Delta (I - M11 Delta)^-1 M12; rows: the parameter of each row of Delta, from 0 on.
function close_loop(M11, M12, M21, M22, rows, deltas)
    isempty(rows) && return M22
    delta = deltas[rows .+ 1]
    loop = I - M11 .* transpose(delta)
    return M22 + (M21 .* transpose(delta)) * (loop \ M12)
end

function matrices_at(values = Dict{String,Float64}(); archive = ARCHIVE, model = MODEL)
    h5open(archive, "r") do file
        group = file["models"][model]
        A, B_w, B_u, C_z, D_zw, D_zu, C_y, D_yw, D_yu =
            (matrix(group, name) for name in
             ("A", "B_w", "B_u", "C_z", "D_zw", "D_zu", "C_y", "D_yw", "D_yu"))
        n = size(A, 1)
        M = close_loop(D_zw, [C_z D_zu], [B_w; D_yw], [A B_u; C_y D_yu],
                       read(group["delta/parameter"]), deltas_of(group["parameters"], values))
        return (A = M[1:n, 1:n], B = M[1:n, n+1:end], C = M[n+1:end, 1:n], D = M[n+1:end, n+1:end])
    end
end

function trim_at(values = Dict{String,Float64}(); archive = ARCHIVE, model = MODEL)
    h5open(archive, "r") do file
        group = file["models"][model]
        haskey(group, "trim") && haskey(group["trim"], "lft") || error("no LFT of the trim is stored")
        static = group["trim/lft"]
        D_zw, D_zu, D_yw, D_yu = (matrix(static, name) for name in ("D_zw", "D_zu", "D_yw", "D_yu"))
        found = close_loop(D_zw, D_zu, D_yw, D_yu, read(static["delta/parameter"]),
                           deltas_of(group["parameters"], values))
        return Dict(zip(texts(group["trim"], "name"), found[:, 1]))
    end
end
<% if theta %>

# The nonlinear functions Theta, by <<stem>>.c, which the compiler CC (by default cc) is called for:
#
#     rates, y, zeta = rates_at(x, u, Dict("NAME" => value))   # parameters that are not given are nominal
#     zeta, slopes = theta(omega)
#
<<functions>>

using Libdl

const LIBRARY = joinpath(mktempdir(), "model." * Libdl.dlext)
const SOURCE = joinpath(@__DIR__, <<source>>)
run(`$(get(ENV, "CC", "cc")) -std=c99 -O2 -shared -fPIC -o $LIBRARY $SOURCE -lm`)

const INITIAL = <<initial>>
const ZETA_AT_START = <<start>>
const PARAMETERS = String[<<names>>]
const LOW, NOMINAL, HIGH = <<low>>, <<nominal>>, <<high>>
const REASONS = ("a value is outside of its range", "the model is singular there",
                 "Theta is evaluated outside of the range of an argument",
                 "the values of Theta were not found near those that were given")

function theta(omega)
    zeta, slopes = zeros(<<nz>>), zeros(<<no>>, <<nz>>)
    status = ccall((:<<name>>_theta, LIBRARY), Cint, (Ptr{Cdouble}, Ptr{Cdouble}, Ptr{Cdouble}),
                   Vector{Float64}(omega), zeta, slopes)
    status == 0 || error(REASONS[status])
    return zeta, permutedims(slopes)  # rows of C are columns of Julia
end

function rates_at(x, u, values = Dict{String,Float64}(); zeta = ZETA_AT_START)
    for name in keys(values)
        name in PARAMETERS || error("unknown parameter $name. Existing: $(join(PARAMETERS, ", "))")
    end
    p = Float64[get(values, name, nominal) for (name, nominal) in zip(PARAMETERS, NOMINAL)]
    for (name, value, low, high) in zip(PARAMETERS, p, LOW, HIGH)
        slack = 1e-9 * (high - low)
        low - slack <= value <= high + slack ||
            error("$name = $value is outside its range [$low, $high]")
    end
    rates, y, found = zeros(<<nx>>), zeros(<<ny>>), Vector{Float64}(zeta)
    status = ccall((:<<name>>_derivative, LIBRARY), Cint,
                   (Ptr{Cdouble}, Ptr{Cdouble}, Ptr{Cdouble}, Ptr{Cdouble}, Ptr{Cdouble}, Ptr{Cdouble}),
                   p, Vector{Float64}(x), Vector{Float64}(u), found, rates, y)
    status == 0 || error(REASONS[status])
    return (rates = rates, y = y, zeta = found)
end
<% endif %>
