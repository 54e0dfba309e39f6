"""Laws of component modes."""

import numpy as np
import pytest
import scipy.linalg
import scipy.sparse as sp
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

import mbdlft
from mbdlft import FiniteElements, ModalModel, Nodes, modal_model
from mbdlft.elastic.nodes import transport
from mbdlft.elastic.partition import mass_matrix, partitioned
from mbdlft.elastic.reduction import Structure, candidates
from mbdlft.multibody.body.elastic import dense
from tests import kit
from tests.close import roundoff
from tests.reference.frames import ALUMINUM, frame, straight, tee

Array = NDArray[np.float64]
COUNT = 3  # elements of each bar of the T
PARENT, RIGHT, LEFT = 10, 10 * (2 * COUNT + 1), 10 * (3 * COUNT + 1)
PORTS = {"right": RIGHT, "left": LEFT}
METHODS = ("hurty", "craig-bampton", "effective-mass", "static-correction")


def rows(nodes: Nodes, number: int) -> Array:
    return np.flatnonzero(np.asarray(nodes.dof)[:, 0] == number)


def conditioned(fe: FiniteElements, parent: int = PARENT) -> float:
    """(highest/lowest frequency)^2 of the structure held at a node: what rounding is multiplied with."""
    free = np.setdiff1d(np.arange(len(fe.mass_matrix)), rows(fe.nodes, parent))
    w2 = scipy.linalg.eigvalsh(
        fe.stiffness_matrix[np.ix_(free, free)], fe.mass_matrix[np.ix_(free, free)]
    )
    return float(w2[-1] / w2[0])


def transfer(m: ModalModel, s: complex) -> NDArray[np.complex128]:
    """[accelerations of ports ; reaction on the parent] from [loads at ports ; its acceleration]."""
    shapes = np.vstack([m.shapes[port] for port in m.ports])
    inputs = np.hstack([shapes.T, -m.participation.T])
    accelerations = s**2 * inputs / (s**2 + m.frequencies**2)[:, None]
    moved = np.vstack([transport(position) for position in m.ports.values()])
    through = np.block([[np.zeros((len(moved),) * 2), moved], [moved.T, -mass_matrix(m.rigid)]])
    return np.asarray(np.vstack([shapes, -m.participation]) @ accelerations + through)


def transfer_of_matrices(fe: FiniteElements, s: complex) -> NDArray[np.complex128]:
    """The same by solving (s^2 M + K) q = f of the whole structure, with no modes."""
    M, K, nodes = fe
    held = rows(nodes, PARENT)
    free = np.setdiff1d(np.arange(len(M)), held)
    ports = np.concatenate([rows(nodes, number) for number in PORTS.values()])
    dynamic = s**2 * M + K
    loads = np.zeros((len(M), len(ports) + 6), dtype=complex)
    loads[ports, range(len(ports))] = 1.0
    motion = np.zeros((len(held), len(ports) + 6), dtype=complex)
    motion[:, len(ports) :] = np.eye(6) / s**2  # unit acceleration
    q = np.zeros_like(loads)
    q[held] = motion
    q[free] = np.linalg.solve(dynamic[np.ix_(free, free)], (loads - dynamic[:, held] @ motion)[free])
    reaction = -(dynamic @ q)[held]
    return np.vstack([s**2 * q[ports], reaction])


# --- blocks of the transformed matrices ------------------------------------------------------------


def test_blocks_vanish() -> None:
    """(4.29): K^ = diag(w^2, Kee^, 0), Mnn^ = 1; the rows of the rigid motions vanish."""
    fe = tee(COUNT)
    at = partitioned(fe.nodes, PARENT, PORTS)
    M, K = (at.expand.T @ matrix @ at.expand for matrix in fe[:2])
    structure = Structure(sp.csr_array(M), sp.csr_array(K), at)
    found = candidates(structure, "hurty", fe.nodes)
    modes = found.modes(5)
    reduced = found.reduce(modes)
    k = len(modes)
    size = np.sqrt(np.diag(reduced.stiffness))
    relative = reduced.stiffness / np.outer(size, size)
    kappa = conditioned(fe)
    roundoff(relative[:k, :k], np.eye(k), kappa)
    roundoff(relative[:k, k:], np.zeros_like(relative[:k, k:]), kappa, scale=1.0)
    roundoff(reduced.mass[:k, :k], np.eye(k), kappa)
    terms = np.abs(at.rigid).T @ (np.abs(K) @ np.abs(at.rigid))
    roundoff(at.rigid.T @ K @ at.rigid / np.max(terms), np.zeros((6, 6)), scale=1.0)


# --- rigid mass ------------------------------------------------------------------------------------


def test_rigid_mass_is_that_of_a_beam() -> None:
    """m, m L/2, m L^2/3 of a uniform beam about its end."""
    length = 2.0
    m = modal_model(*straight(5, length), 10, {"tip": 60}, modes=2)
    line = ALUMINUM.rho * ALUMINUM.A
    mass, polar = line * length, ALUMINUM.rho * (ALUMINUM.I_y + ALUMINUM.I_z) * length
    expected = mass * transport([length / 2, 0, 0])
    expected[3:, :3] = expected[:3, 3:].T
    expected[3:, 3:] = np.diag([polar, mass * length**2 / 3, mass * length**2 / 3])
    roundoff(mass_matrix(m.rigid), expected, kappa=10.0)
    roundoff(m.ports["tip"], [length, 0.0, 0.0])


# --- effective masses ------------------------------------------------------------------------------


def test_all_effective_masses_are_the_rigid_mass() -> None:
    """P P' of all modes, with what moves with the parent alone, is the rigid mass matrix."""
    fe = tee(COUNT)
    M, _, nodes = fe
    held = rows(nodes, PARENT)
    free = np.setdiff1d(np.arange(len(M)), held)
    # the smallest kinetic energy of a motion of the parent: its Schur complement
    interface = M[np.ix_(held, held)] - M[np.ix_(held, free)] @ np.linalg.solve(
        M[np.ix_(free, free)], M[np.ix_(free, held)]
    )
    for method in METHODS:
        count = len(free) - (12 if method in METHODS[:2] else 0)
        m = modal_model(*fe, PARENT, PORTS, method=method, modes=count)
        report = mbdlft.effective_masses(m)
        roundoff(report.residual, interface, conditioned(fe), float(np.max(report.rigid)))
        shares = np.sum(report.masses, axis=0) / np.diag(report.rigid)
        roundoff(report.kept, shares)


# --- transfers -------------------------------------------------------------------------------------


def test_three_methods_have_the_transfer_of_the_matrices() -> None:
    fe = tee(COUNT)
    free = len(fe.mass_matrix) - 6
    w1 = modal_model(*fe, PARENT, PORTS, method="effective-mass", modes=1).frequencies[0]
    for s in (0.3j * w1, (0.2 + 2.5j) * w1, (0.5 + 30j) * w1):
        expected = transfer_of_matrices(fe, s)
        rescale = np.sqrt(np.abs(np.diag(expected)))
        scale = np.outer(rescale, rescale)
        for method in METHODS:
            count = free - (12 if method in METHODS[:2] else 0)
            found = transfer(modal_model(*fe, PARENT, PORTS, method=method, modes=count), s)
            roundoff(found / scale, expected / scale, conditioned(fe))


def test_correction_is_exact_for_static_loads() -> None:
    """With static correction K^-1 of the ports is that of the matrices; the modes stay as they are."""
    fe = tee(COUNT)
    K, nodes = fe.stiffness_matrix, fe.nodes
    free = np.setdiff1d(np.arange(len(K)), rows(nodes, PARENT))
    ports = np.searchsorted(free, np.concatenate([rows(nodes, n) for n in PORTS.values()]))
    expected = np.linalg.inv(K[np.ix_(free, free)])[np.ix_(ports, ports)]
    size = np.sqrt(np.diag(expected))
    plain = modal_model(*fe, PARENT, PORTS, method="effective-mass", modes=3)
    found = modal_model(*fe, PARENT, PORTS, method="static-correction", modes=3)
    shapes = np.vstack([found.shapes[port] for port in PORTS])
    flexibility = (shapes / found.frequencies**2) @ shapes.T
    roundoff(flexibility / np.outer(size, size), expected / np.outer(size, size), conditioned(fe))
    roundoff(found.frequencies[:3], plain.frequencies, conditioned(fe))


@pytest.mark.parametrize("times", [1.0, 10.0])
def test_loaded_port_needs_static_correction(times: float) -> None:
    """With a mass at a port effective-mass modes are percents off, and say so; the correction is not."""
    fe = tee(COUNT)
    free = np.setdiff1d(np.arange(len(fe.mass_matrix)), rows(fe.nodes, PARENT))
    weight = times * modal_model(*fe, PARENT, PORTS, modes=1).rigid.mass
    M, K = (np.array(matrix)[np.ix_(free, free)] for matrix in fe[:2])
    right = np.searchsorted(free, rows(fe.nodes, RIGHT))[:3]
    M[right, right] += weight
    exact = 1.0 / np.sqrt(scipy.linalg.eigh(M, K, eigvals_only=True)[:-7:-1])

    def lowest(m: ModalModel) -> Array:
        moved = m.shapes["right"][:3]
        loaded = np.eye(len(m.frequencies)) + weight * moved.T @ moved
        inverse = scipy.linalg.eigvalsh(loaded / np.outer(m.frequencies, m.frequencies))
        return np.asarray(1.0 / np.sqrt(inverse[:-7:-1]))

    plain = modal_model(*fe, PARENT, PORTS, method="effective-mass", modes=6)
    corrected = modal_model(*fe, PARENT, PORTS, method="static-correction", modes=6)
    assert np.max(np.abs(lowest(corrected) / exact - 1.0)) < 0.005
    assert np.max(lowest(plain) / exact - 1.0) > 0.015
    assert corrected.lacking() is None
    if times == 1.0:
        off = np.max(lowest(plain) / lowest(corrected) - 1.0)
        assert abs(plain.port_errors["right"] - off) < 1e-6
    with pytest.warns(mbdlft.MbdlftWarning, match="body 'arm', port '.*static-correction"):
        mbdlft.modal_body("arm", plain)
    mbdlft.modal_body("arm", corrected)


def test_structure_that_is_turned_and_moved() -> None:
    """The same matrices with the nodes elsewhere: all is turned, and nothing else is changed."""
    fe, Q = tee(COUNT), np.array([[0.36, 0.48, -0.8], [-0.8, 0.6, 0.0], [0.48, 0.64, 0.6]])
    place = np.asarray(fe.nodes.coordinates) @ Q.T + [0.5, -2.0, 1.5]
    numbers = np.asarray(fe.nodes.numbers)
    nodes = Nodes(numbers, place, fe.nodes.dof, np.broadcast_to(Q, (len(place), 3, 3)))
    here = modal_model(*fe, PARENT, PORTS, modes=4)
    there = modal_model(*fe[:2], nodes, PARENT, PORTS, modes=4)
    roundoff(there.frequencies / here.frequencies, np.ones(len(here.frequencies)), conditioned(fe))
    for name in PORTS:
        roundoff(there.ports[name], Q @ here.ports[name])
    roundoff(there.rigid.center, Q @ here.rigid.center, kappa=10.0)
    roundoff(there.rigid.inertia, Q @ here.rigid.inertia @ Q.T, kappa=10.0)
    turned = np.kron(np.eye(2 * len(PORTS) + 2), Q)
    s = (0.1 + 1.7j) * float(here.frequencies[0])
    roundoff(transfer(there, s), turned @ transfer(here, s) @ turned.T, conditioned(fe))


def test_hurty_and_craig_bampton_span_the_same() -> None:
    """With the same few modes kept, not only with all of them."""
    fe = tee(COUNT)
    for count in (0, 1, 4):
        a, b = (modal_model(*fe, PARENT, PORTS, method=method, modes=count) for method in METHODS[:2])
        roundoff(a.frequencies / b.frequencies, np.ones(len(a.frequencies)), conditioned(fe))
        s = (0.1 + 1.7j) * float(a.frequencies[0])
        roundoff(transfer(a, s), transfer(b, s), conditioned(fe))


def test_static_loads_are_exact() -> None:
    """Constraint modes make the deflection by loads at ports exact, however few modes are kept."""
    fe = tee(COUNT)
    M, K, nodes = fe
    free = np.setdiff1d(np.arange(len(M)), rows(nodes, PARENT))
    ports = np.concatenate([rows(nodes, number) for number in PORTS.values()])
    loads = np.eye(len(M))[:, ports]
    expected = np.linalg.solve(K[np.ix_(free, free)], loads[free])
    expected = (loads[free].T) @ expected
    scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    for method in METHODS[:2]:
        m = modal_model(*fe, PARENT, PORTS, method=method, modes=1)
        shapes = np.vstack([m.shapes[port] for port in PORTS])
        found = shapes @ (shapes / m.frequencies**2).T
        roundoff(found / scale, expected / scale, conditioned(fe))
    low = transfer(modal_model(*fe, PARENT, PORTS, modes=1), 0.0j)
    moved = np.vstack([transport(p) for p in ([0.9, 0.75, 0], [0.9, -0.75, 0])])
    roundoff(low[:12, :12].real, np.zeros((12, 12)), scale=1.0)
    roundoff(low[:12, 12:].real, moved)
    roundoff(low[12:, 12:].real, low[12:, 12:].T.real)


@given(count=st.integers(0, 12), method=st.sampled_from(METHODS), elements=st.integers(2, 4))
def test_residual_mass_is_not_negative(count: int, method: str, elements: int) -> None:
    fe = tee(elements)
    ports = {"right": 10 * (2 * elements + 1)}
    m = modal_model(*fe, PARENT, ports, method=method, modes=max(count, 1))
    report = mbdlft.effective_masses(m)
    size = np.sqrt(np.diag(report.rigid))
    relative = report.residual / np.outer(size, size)
    roundoff(min(0.0, float(np.linalg.eigvalsh(relative)[0])), 0.0, conditioned(fe), scale=1.0)
    assert np.all(report.kept < 1.0)
    assert "sum" in report.table()


def test_results_give_the_same_model() -> None:
    """Frequencies, reactions and shapes that an analysis prints, with modes of any mass."""
    fe = tee(COUNT)
    M, K, nodes = fe
    held = rows(nodes, PARENT)
    free = np.setdiff1d(np.arange(len(M)), held)
    w2, modes = scipy.linalg.eigh(K[np.ix_(free, free)], M[np.ix_(free, free)])
    phi = np.zeros((len(M), 8))
    phi[free] = modes[:, :8] * np.arange(1.0, 9.0)
    # the load on the support: what the constraint has to put on the structure, with the other sign
    reactions = -(K @ phi - M @ phi * w2[:8])[held]
    expected = modal_model(*fe, PARENT, PORTS, method="effective-mass", modes=8)
    found = mbdlft.model_of_results(
        np.sqrt(w2[:8]),
        reactions,
        {port: phi[rows(nodes, number)] for port, number in PORTS.items()},
        expected.ports,
        mass=expected.rigid.mass,
        center=expected.rigid.center,
        inertia=expected.rigid.inertia,
        modal_masses=np.arange(1.0, 9.0) ** 2,
    )
    s = (0.1 + 1.7j) * float(expected.frequencies[0])
    roundoff(transfer(found, s), transfer(expected, s), conditioned(fe))


# --- how many modes --------------------------------------------------------------------------------


@pytest.mark.parametrize("method", METHODS)
def test_modes_by_frequency_and_by_effective_mass(method: str) -> None:
    fe = tee(COUNT)
    free = modal_model(*fe, PARENT, PORTS, method=method, modes=10)
    by_frequency = modal_model(*fe, PARENT, PORTS, method=method, frequency=3e3)
    one_more = modal_model(*fe, PARENT, PORTS, method=method, modes=by_frequency.kept + 1)
    if method == "effective-mass":
        assert by_frequency.frequencies[-1] <= 3e3 < one_more.frequencies[-1]
    assert free.kept == 10
    by_mass = modal_model(*fe, PARENT, PORTS, method=method, effective_mass=0.6)
    assert np.min(mbdlft.effective_masses(by_mass).kept) >= 0.6
    if by_mass.kept > 1:
        fewer = modal_model(*fe, PARENT, PORTS, method=method, modes=by_mass.kept - 1)
        assert np.min(mbdlft.effective_masses(fewer).kept) < 0.6


def test_iterative_and_dense_modes_agree(monkeypatch: pytest.MonkeyPatch) -> None:
    equal = ALUMINUM._replace(I_z=ALUMINUM.I_y)  # every bending mode twice
    fe, ports = straight(9, 3.0, equal), {"right": 60}
    whole = modal_model(*fe, PARENT, ports, modes=12)
    monkeypatch.setattr(mbdlft.elastic.reduction, "_DENSE", 0)
    assert modal_model(*fe, PARENT, ports, modes=0).kept == 0
    found = modal_model(*fe, PARENT, ports, modes=12)
    roundoff(found.frequencies / whole.frequencies, np.ones(18), conditioned(fe))
    roundoff(whole.frequencies[1] / whole.frequencies[0], 1.0, conditioned(fe))
    s = (0.1 + 1.7j) * float(whole.frequencies[0])
    moved = np.abs(whole.shapes["right"] @ (whole.shapes["right"] / (s**2 + whole.frequencies**2)).T)
    again = np.abs(found.shapes["right"] @ (found.shapes["right"] / (s**2 + found.frequencies**2)).T)
    roundoff(again, moved, conditioned(fe))


# --- against the beam of the package, and a whole structure -----------------------------------------


@pytest.mark.parametrize("elements", [1, 3, 6])
def test_beam_body_has_the_frequencies_of_its_matrices(elements: int) -> None:
    """The Euler-Bernoulli beam body against textbook matrices: all frequencies, all participations."""
    s, length = ALUMINUM, 2.0
    beam = mbdlft.Beam(
        name="beam", length=length, density=s.rho, area=s.A, modulus=s.E, shear_modulus=s.G,
        I_y=s.I_y, I_z=s.I_z, torsion_constant=s.J, elements=elements,
    )  # fmt: skip
    values = {label: np.array([expected.source]) for label, expected in beam.quantities().items()}
    e = beam.elastic(values)
    mass, stiffness, coupling = (dense(part, 1)[0] for part in (e.mass, e.stiffness, e.participation))
    w2 = scipy.linalg.eigvalsh(stiffness, mass)
    fe = straight(elements, length)
    kappa = float(w2[-1] / w2[0])
    tip = 10 * (elements + 1)
    if elements == 1:
        held = np.arange(6, 12)
        by_hand = scipy.linalg.eigvalsh(
            fe.stiffness_matrix[np.ix_(held, held)], fe.mass_matrix[np.ix_(held, held)]
        )
        roundoff(np.sqrt(by_hand / w2), np.ones(6), kappa)
        return
    m = modal_model(*fe, 10, {"tip": tip}, method="effective-mass", modes=6 * elements)
    roundoff(m.frequencies**2 / w2, np.ones(len(w2)), kappa)
    roundoff(m.participation @ m.participation.T, coupling @ np.linalg.solve(mass, coupling.T), kappa)
    shapes = dense(beam.shapes("tip", values), 1)[0]
    roundoff(
        m.shapes["tip"] @ (m.shapes["tip"] / m.frequencies**2).T,
        shapes @ np.linalg.solve(stiffness, shapes.T),
        kappa,
    )


def halves() -> tuple[FiniteElements, FiniteElements]:
    """The stem of the T, and its arms with the node of the crossing, each with matrices of its own."""
    x = 0.3 * np.arange(COUNT + 1)
    stem = frame(np.stack([x, 0 * x, 0 * x], axis=1), [(k, k + 1) for k in range(COUNT)])
    y = 0.25 * np.arange(-COUNT, COUNT + 1)
    bars = [(k, k + 1) for k in range(2 * COUNT)]
    return stem, frame(np.stack([0 * y, y, 0 * y], axis=1), bars)


@pytest.mark.parametrize("method", METHODS[:2])
def test_two_bodies_are_the_whole_structure(method: str) -> None:
    """Stem and arms joined in a scene against the matrices of the T in one piece."""
    stem, arms = halves()
    crossing, right, left = 10 * (COUNT + 1), 10 * (2 * COUNT + 1), 10
    bodies = [
        mbdlft.flexible_body(
            "stem", *stem, 10, {"top": crossing}, method=method, modes=6 * (COUNT - 1)
        ),
        mbdlft.flexible_body(
            "arms", *arms, crossing, {"right": right, "left": left}, method=method,
            modes=6 * (2 * COUNT - 2),
        ),
    ]  # fmt: skip
    scene = kit.scene(
        "tee",
        *bodies,
        kit.weld("foot", "ground", "stem"),
        kit.weld("crossing", "stem.top", "arms"),
        kit.force("push", "arms.right", (0, 0, 1), magnitude=0),
        mbdlft.Acceleration(name="felt", port="arms.left"),
        inputs=["push.force"],
        outputs=["felt.z"],
    )
    model = mbdlft.to_lft(scene, search=0.0)
    whole = tee(COUNT)
    M, K, nodes = whole
    free = np.setdiff1d(np.arange(len(M)), rows(nodes, PARENT))
    w2 = scipy.linalg.eigvalsh(K[np.ix_(free, free)], M[np.ix_(free, free)])
    found = np.sort(np.linalg.eigvals(model.A).imag)[len(w2) :]
    roundoff(found[:10] / np.sqrt(w2[:10]), np.ones(10), conditioned(whole))
    s = 1j * np.array([0.5, 1.7, 9.0]) * np.sqrt(w2[0])
    response = mbdlft.frequency_response(model, {}, np.abs(s))[0, :, 0, 0]
    expected = [transfer_of_matrices(whole, point)[8, 2] for point in s]
    roundoff(response, expected, conditioned(whole))
