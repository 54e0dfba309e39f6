"""The equations in maximal coordinates around an equilibrium, solved for the signals of a model.

The states and inputs z give the displacements x of all bodies, their derivatives v and a, the multipliers
lambda of the constraints and the efforts e of what is imposed:

    G x = 0,                     s_j(x) = q_j of the states
    G v = -(dG/dt) x,            ds_j/dt = v_j of the states
    M a - G' lambda - J' e = W z - K x - D v
    G a = -(d2G/dt2) x - 2 (dG/dt) v, and so for what is imposed

Rows of outputs are linear in [x ; v ; a ; lambda ; e ; z].
"""

from collections.abc import Callable
from functools import cached_property
from typing import Any, NamedTuple

import flint
import numpy as np

import mbdlft
from tests.cross import poses
from tests.cross.links import Coupling, Link
from tests.cross.maximal import Bodies
from tests.cross.sizes import Sized, Sum, plain, sized
from tests.cross.touches import Touch

BALL = 1e-25  # of a value: what its bits have lost
LOST = 1e-30  # of a slope, that rounding of differences may change
NOTHING = 1e-18  # of an entry: what differences leave of a zero
MISSED = 1e-25  # of the loads, or m of a closure: an equilibrium is exact


class Truth(NamedTuple):
    """[A B ; C D] at one point, sizes of its terms, and the trim by name; what it misses, relative."""

    matrix: np.ndarray
    sizes: np.ndarray
    trim: dict[str, float]
    missed: float


def linear_model(scene: mbdlft.Scene, point: dict[str, float], model: mbdlft.LFTModel) -> Truth:
    """The truth with the signals of a model, at physical values by name."""
    return _in_bits(lambda: _Solved(Bodies(scene, point), model).truth())


def contact_forces(scene: mbdlft.Scene, point: dict[str, float]) -> tuple[list[str], list[str]]:
    """Names of the forces of contacts that the equations determine, and of those that they share."""
    return _in_bits(lambda: _Solved(Bodies(scene, point)).contact_forces())


def fault(scene: mbdlft.Scene, point: dict[str, float]) -> str:
    """Why a scene has no linear model at a point: no equilibrium, several, or motions that contradict."""
    return _in_bits(lambda: _Solved(Bodies(scene, point)).fault())


def _in_bits(made: Callable[[], Any]) -> Any:
    """What is made in 512 bits; in twice as many where differences have lost too many of them."""
    before = flint.ctx.prec
    for bits in (poses.BITS, 2 * poses.BITS, 4 * poses.BITS):
        flint.ctx.prec = bits
        try:
            return made()
        except _TooFewBitsError:
            continue
        finally:
            flint.ctx.prec = before
    raise AssertionError("too few bits")


class _TooFewBitsError(ArithmeticError):
    """A difference has no digits left."""


Pair = tuple[Link, int]  # a link and a row of its relation
Terms = list[tuple[Any, Link, int]]  # a combination of such rows, with coefficients


class _Around:
    """Slopes of relations and of forces by displacements, rates and accelerations, (rows, 3 n)."""

    def __init__(self, bodies: Bodies) -> None:
        self.bodies, self.n = bodies, bodies.n
        b = bodies
        self.moving: dict[str, np.ndarray] = {}  # of the relation, its rates, its second derivatives
        self.jacobian: dict[str, np.ndarray] = {}  # (rows, n)
        self.bent: dict[str, np.ndarray] = {}  # slopes of the Jacobian, (rows, n, n)
        for link in [*b.links, *b.touches]:
            here = b.motion(link.parent), b.motion(link.child)
            rows = poses.rows_of([b.spread(link, row) for row in link.jacobian(*here)], b.n)
            self.jacobian[link.name] = rows

            def bent(P: poses.Motion, C: poses.Motion, link: Link = link) -> poses.Values:
                return [x for row in link.jacobian(P, C) for x in b.spread(link, row)]

            self.bent[link.name] = self.slopes(bent, link, orders=1).reshape(len(rows), b.n, b.n)
            self.moving[link.name] = self.slopes(link.in_time, link)

    def slopes(
        self, f: Callable[[poses.Motion, poses.Motion], poses.Values], link: Any, orders: int = 3
    ) -> np.ndarray:
        """Slopes of a function of the motions of the two bodies of a link."""
        P, C = self.bodies.motion(link.parent), self.bodies.motion(link.child)
        before = f(P, C)
        whole = poses.zeros(len(before), orders * self.n)
        for order in range(orders):
            for k in range(6):
                column = order * self.n + k
                if link.parent >= 0:
                    after = f(P.moved(order, k), C)
                    whole[:, column + 6 * link.parent] = _quotients(before, after)
                if link.child >= 0:
                    after = f(P, C.moved(order, k))
                    whole[:, column + 6 * link.child] = _quotients(before, after)
        return whole

    def of_body(self, f: Callable[[poses.Motion], poses.Values], k: int) -> np.ndarray:
        """Slopes of a function of the motion of one body."""
        alone = Link("", -1, k, lambda P, C: [])
        return self.slopes(lambda P, C: f(C), alone)

    def rows(self, order: int, sums: list[Terms]) -> list[np.ndarray]:
        """Slopes (rows, n) of derivatives of some order by displacements, rates and accelerations."""
        rows = [self.of_sum(self.moving, terms, order) for terms in sums]
        return np.split(poses.rows_of(rows, 3 * self.n), 3, axis=1)

    def of_sum(self, slopes: dict[str, np.ndarray], terms: Terms, order: int = 0) -> np.ndarray:
        """A combination of the rows of some order."""
        return sum(c * slopes[x.name][order * len(self.jacobian[x.name]) + i] for c, x, i in terms)


def _quotients(before: poses.Values, after: poses.Values) -> poses.Values:
    # balls would grow in what is solved with them: numbers go on, whose errors are those of the step
    quotients = [(y - x) / poses.STEP for x, y in zip(before, after, strict=True)]
    if any(float(x.rad()) > LOST * (1.0 + abs(float(x.mid()))) for x in quotients):
        raise _TooFewBitsError
    return [flint.arb(x.mid()) for x in quotients]


def _single(pair: Pair) -> Terms:
    return [(flint.arb(1), *pair)]


def _rolls(terms: Terms) -> bool:
    """Whether a constraint holds for rates only."""
    (_, x, i), *_ = terms
    return isinstance(x, Touch) and i >= x.held


class _Solved:
    """The equilibrium and motions around it, by the states and inputs of a model."""

    def __init__(self, bodies: Bodies, model: mbdlft.LFTModel | None = None) -> None:
        self.b, self.n = bodies, bodies.n
        self.states, self.inputs, self.outputs, self.asked = (
            (model.states, model.inputs, model.outputs, model.trim.signals) if model else ((),) * 4
        )
        self.place = {s.name: k for k, s in enumerate([*self.states, *self.inputs])}
        self.at = _Around(bodies)
        self.loads = {x.name: x for x in bodies.scene.loads if x.kind not in ("spring", "strut")}
        every = [(x, i) for x in bodies.links for i in range(len(x.laws), len(self.at.jacobian[x.name]))]
        sums = [_single(pair) for pair in every]
        self.rigid = [c for c in bodies.couplings if c.stiffness is None]
        self.soft = [c for c in bodies.couplings if c.stiffness is not None]
        sums += [coupling.combination for coupling in self.rigid]
        sums += [
            [(flint.arb(1), x, i)] for x in bodies.touches for i in range(len(self.at.jacobian[x.name]))
        ]
        G = poses.rows_of([self.at.of_sum(self.at.jacobian, terms) for terms in sums], self.n)
        self.every, kept = (sums, G), poses.independent(G)
        self.G, self.held = G[kept], [sums[k] for k in kept]
        self.imposed = [(x, i) for x in bodies.joints if x.imposed for i in range(len(x.laws))]
        self.rotors = [(x, rotor) for x in bodies.joints for rotor in x.rotors]
        self.rotor_slopes = [self.at.slopes(self._needs(x, rotor), x) for x, rotor in self.rotors]

    def _needs(self, link: Link, rotor: Any) -> Callable[[poses.Motion, poses.Motion], poses.Values]:
        return lambda P, C: self.b.rotor_needs(link, rotor, P, C)

    def _rotor_part(self, link: Link, rotor: Any) -> slice:
        body = link.parent if rotor.on_parent else link.child
        return slice(6 * body + 3, 6 * body + 6) if body >= 0 else slice(0)

    # the equilibrium ----------------------------------------------------------------------------

    @cached_property
    def acting(self) -> dict[str, np.ndarray]:
        """What one unit of each effort, load and acceleration of the ground exerts (n,)."""
        b, acting = self.b, {}
        for link in b.links:
            for law, row in zip(link.laws, self.at.jacobian[link.name], strict=False):
                acting[law.effort] = row * law.gain
        for soft in self.soft:
            acting[soft.force] = self.at.of_sum(self.at.jacobian, soft.combination)
        for load in self.loads.values():
            k, push = b.port(getattr(load, "port", None) or load.child)[0], poses.zeros(self.n)
            if k >= 0:
                push[6 * k : 6 * k + 6] = b.pushed(load, b.motions[k])
            acting[f"{load.name}.{load.signal.name}"] = push
        for axis, name in zip(poses.AXES, "xyz", strict=True):
            pull = [
                x - y
                for k, m in enumerate(b.motions)
                for x, y in zip(b.needed(k, m), b.needed(k, m, axis), strict=True)
            ]
            acting[f"ground.acceleration.{name}"] = np.array(pull, dtype=object)
        return acting

    @cached_property
    def equilibrium(self) -> "_Equilibrium":
        b, known = self.b, dict[str, Any]()
        for link in b.links:
            known |= {law.effort: law.preset for law in link.laws}
        known |= {soft.force: soft.preset for soft in self.soft}
        for load in self.loads.values():
            size = getattr(load, load.magnitude_key)
            known[f"{load.name}.{load.signal.name}"] = None if size is None else b.value(size)
        for axis, a in zip("xyz", b.scene.acceleration, strict=True):
            known[f"ground.acceleration.{axis}"] = None if a == "unknown" else 0
        left = Sum(self.n)  # what is not balanced yet
        for k, m in enumerate(b.motions):
            left.add(slice(6 * k, 6 * k + 6), np.array(b.needed(k, m), dtype=object))
        for link, rotor in self.rotors:
            now = b.rotor_needs(link, rotor, b.motion(link.parent), b.motion(link.child))
            part = self._rotor_part(link, rotor)
            left.add(part, np.array(now[1:], dtype=object)[: part.stop - (part.start or 0)])
            left.add(slice(None), self.at.jacobian[link.name][rotor.coordinate] * now[0])
        at_rest = {}
        for link in b.links:
            for i, law in enumerate(link.laws):
                at_rest[link.name, i] = law.tension - law.damping * law.rate
                left.add(slice(None), -self.at.jacobian[link.name][i] * at_rest[link.name, i])
        unknown = [name for name, size in known.items() if size is None]
        for name, size in known.items():
            if size is not None:
                left.add(slice(None), -self.acting[name] * size)
        columns = np.vstack([poses.rows_of([self.acting[name] for name in unknown], self.n), self.G]).T
        chosen, rows = poses.independent(columns.T), poses.independent(columns)
        solution, sizes = poses.zeros(columns.shape[1], 1), np.zeros((columns.shape[1], 1))
        right = left.value[rows, None], left.size[rows, None]
        solution[chosen], sizes[chosen] = sized(columns[np.ix_(rows, chosen)], right, [])
        missed = (left.value[:, None] - poses.times(columns, solution)).astype(float)
        size = {name: abs(float(x)) for name, x in known.items() if x is not None}
        size |= dict(zip(unknown, sizes[:, 0], strict=False))
        known |= dict(zip(unknown, solution[:, 0], strict=False))
        forces = {}
        for link in b.links:
            for i, law in enumerate(link.laws):
                at_rest[link.name, i] += law.gain * known[law.effort]
                add = abs(float(law.gain)) * size[law.effort]
                forces[link.name, i] = at_rest[link.name, i], abs(float(at_rest[link.name, i])) + add
        of_sums = [*zip(self.held, solution[len(unknown) :, 0], sizes[len(unknown) :, 0], strict=True)]
        of_sums += [(soft.combination, known[soft.force], size[soft.force]) for soft in self.soft]
        for terms, force, its_size in of_sums:
            for c, x, i in terms:
                before = forces.get((x.name, i), (0, 0.0))
                forces[x.name, i] = before[0] + c * force, before[1] + abs(float(c)) * its_size
        multipliers = {id(terms): force for terms, force, _ in of_sums}
        known |= {rigid.force: multipliers[id(rigid.combination)] for rigid in self.rigid}
        for terms, force, _ in of_sums:
            if isinstance(terms[0][1], Touch):
                known[terms[0][1].names[terms[0][2]]] = force
        most = max(1.0, np.max(np.abs(left.value.astype(float)), initial=0.0))
        worst = float(np.max(np.abs(missed), initial=0.0)) / most
        return _Equilibrium(known, size, forces, max(worst, self._gap()), columns.shape[1] - len(chosen))

    def _gap(self) -> float:
        """How far closures are from closed: their slopes are those of the mechanism at no other place."""
        gaps = [
            abs(float(x))
            for link in self.b.links
            for x in link.relation(self.b.motion(link.parent), self.b.motion(link.child))[
                len(link.laws) :
            ]
        ]
        return max(gaps, default=0.0)

    def contact_forces(self) -> tuple[list[str], list[str]]:
        sums, G = self.every
        names: tuple[list[str], list[str]] = [], []
        for k, ((_, x, i), *_) in enumerate(sums):
            if isinstance(x, Touch):
                is_shared = len(poses.independent(np.delete(G, k, axis=0))) == len(self.held)
                names[is_shared].append(x.names[i])
        return names

    def fault(self) -> str:
        at, driven = self.equilibrium, [pair for pair in self.imposed if pair[0].imposed == "motion"]
        rows = poses.rows_of([self.at.jacobian[x.name][i] for x, i in driven], self.n)
        if len(poses.independent(np.vstack([self.G, rows]))) < len(self.G) + len(driven):
            return "motions that are imposed contradict closures"
        if at.undetermined:
            return "loads are redundant"
        return "no equilibrium" if at.missed > MISSED else ""

    @cached_property
    def falling(self) -> Bodies:
        """The bodies, once what is unknown of the acceleration of the frame is known."""
        known = self.equilibrium.loads
        self.b.fall = self.b.fall + poses.vector([known[f"ground.acceleration.{axis}"] for axis in "xyz"])
        return self.b

    def law_slopes(self, link: Link, i: int) -> np.ndarray:
        """Slopes (3 n,) of what the law of a coordinate and its rotors take of its effort."""
        law, rows, m = link.laws[i], self.at.moving[link.name], len(self.at.jacobian[link.name])
        slopes = rows[i] * law.stiffness + rows[m + i] * law.damping + rows[2 * m + i] * law.inertia
        for (x, rotor), by in zip(self.rotors, self.rotor_slopes, strict=True):
            if x is link and rotor.coordinate == i:
                slopes = slopes + by[0]
        return slopes

    @cached_property
    def slopes(self) -> "Sum":
        """Slopes (n, 3 n) of what the motion needs, less what acts."""
        at, b, slopes = self.equilibrium, self.falling, Sum(self.n, 3 * self.n)
        for k in range(len(b.motions)):
            part = slice(6 * k, 6 * k + 6)
            slopes.add(part, self.at.of_body(lambda m, k=k: b.needed(k, m), k))
        for (link, rotor), by in zip(self.rotors, self.rotor_slopes, strict=True):
            part = self._rotor_part(link, rotor)
            slopes.add(part, by[1 : 1 + part.stop - (part.start or 0)])
        for link in b.links:
            for i in range(len(link.laws)):
                law = self.at.jacobian[link.name][i][:, None] * self.law_slopes(link, i)
                slopes.add(slice(None), law)
        for soft in self.soft:
            force = self.soft_force(soft)
            slopes.add(slice(None), self.at.of_sum(self.at.jacobian, soft.combination)[:, None] * -force)
        for (name, i), (force, size) in at.forces.items():
            bent = np.hstack([self.at.bent[name][i], poses.zeros(self.n, 2 * self.n)])
            slopes.add(slice(None), -bent * force, np.abs(bent.astype(float)) * size)
        for load in self.loads.values():
            k, name = (
                b.port(getattr(load, "port", None) or load.child)[0],
                f"{load.name}.{load.signal.name}",
            )
            if k >= 0:
                by = self.at.of_body(lambda m, x=load: b.pushed(x, m), k)
                size = np.abs(by.astype(float)) * at.sizes[name]
                slopes.add(slice(6 * k, 6 * k + 6), -by * at.loads[name], size)
            if load.name in b.wheels:
                slopes.add(slice(6 * k, 6 * k + 6), -self._of_wheel(load, 0))
        return slopes

    def _of_wheel(self, load: Any, what: int) -> np.ndarray:
        """Slopes of what a wheel pushes with (0), or of its vertical force and its creep (1)."""
        b, k = self.b, self.b.port(load.child)[0]
        wheel, held = b.wheels[load.name], b.motions[k]

        def law(m: poses.Motion) -> poses.Values:
            force, creep = wheel.carried(m, held), wheel.creep(m, held)
            return [force, *creep[:2]] if what else wheel.pushed(m, force, creep)

        return self.at.of_body(law, k)

    def soft_force(self, soft: Coupling) -> np.ndarray:
        """Slopes (3 n,) of the force of a coupling that gives way."""
        e, rate = (self.at.of_sum(self.at.moving, soft.combination, order) for order in (0, 1))
        return -(e * soft.stiffness + rate * soft.damping)

    # motions ------------------------------------------------------------------------------------

    def unit(self, name: str) -> np.ndarray:
        """The row of a state or input among all of them; zeros for another name."""
        row = poses.zeros(len(self.place))
        if name in self.place:
            row[self.place[name]] = flint.arb(1)
        return row

    @cached_property
    def moves(self) -> tuple[np.ndarray, np.ndarray]:
        """[x ; v ; a ; lambda ; e ; z] by z, and their sizes if nothing cancelled."""
        states = {s.name for s in self.states}
        links = self.b.joints
        chosen = [
            (x, i)
            for x in links
            for i, law in enumerate(x.laws)
            if law.measures[1] in states or x.imposed == "motion"
        ]
        nz, none = len(self.place), poses.zeros(len(self.held), len(self.place))
        top = poses.rows_of([self.unit(x.laws[i].measures[1]) for x, i in chosen], nz)
        turning = self.at.rows(1, self.held + [_single(pair) for pair in chosen])
        x = self._displaced(chosen, nz)
        v = sized(turning[1], plain(np.vstack([none, top])), [(*plain(turning[0]), x)])
        K, D, M = np.split(self.slopes.value, 3, axis=1)
        K_size, D_size, _ = np.split(self.slopes.size, 3, axis=1)
        by_x, by_v, by_a = self.at.rows(2, self.held + [_single(pair) for pair in self.imposed])
        pushes = poses.rows_of([self.at.jacobian[x.name][i] for x, i in self.imposed], self.n)
        corner = poses.zeros(len(by_a), len(by_a))
        matrix = np.block([[M, -self.G.T, -pushes.T], [by_a, corner]])
        acting = poses.zeros(self.n, nz)
        for signal in self.inputs:
            if signal.name in self.acting and signal.name not in self._efforts_imposed():
                acting[:, self.place[signal.name]] = self.acting[signal.name]
        given = poses.rows_of([self.unit(x.laws[i].measures[2]) for x, i in self.imposed], nz)
        right = plain(np.vstack([acting, none, given]))
        of_x, of_v = (np.vstack([K_size, plain(by_x)[1]]), np.vstack([D_size, plain(by_v)[1]]))
        less = [(np.vstack([K, by_x]), of_x, x), (np.vstack([D, by_v]), of_v, v)]
        a = sized(matrix, right, less)
        z = poses.rows_of([self.unit(name) for name in self.place], nz)
        return np.vstack([x[0], v[0], a[0], z]), np.vstack([x[1], v[1], a[1], z.astype(float)])

    def _displaced(self, chosen: list[Pair], nz: int) -> Sized:
        """Displacements (n, nz). Where bodies roll more of them are free than rates: others stay zero."""
        held = [terms for terms in self.held if not _rolls(terms)]
        if self.b.touches:
            every = [(x, i) for x in self.b.joints for i in range(len(x.laws))]
            chosen = sorted(every, key=lambda pair: pair[0].laws[pair[1]].measures[0] not in self.place)
        rows, kept = [_single(pair) for pair in chosen], list(held)
        for terms in rows:
            by_x = self.at.rows(0, [*kept, terms])[0]
            if not self.b.touches or len(poses.independent(by_x)) == len(by_x):
                kept.append(terms)
        names = [x.laws[i].measures[0] for ((_, x, i),) in kept[len(held) :]]
        tops = poses.rows_of([self.unit(name) for name in names], nz)
        return sized(self.at.rows(0, kept)[0], plain(np.vstack([poses.zeros(len(held), nz), tops])), [])

    def _efforts_imposed(self) -> set[str]:
        return {x.laws[i].effort for x, i in self.imposed}

    def truth(self) -> Truth:
        moves, sizes = self.moves
        measures = {
            name: (x, i, order)
            for x in self.b.joints
            for i, law in enumerate(x.laws)
            for order, name in enumerate(law.measures)
        }
        rows = []
        for signal in self.states:
            x, i, order = measures[signal.name]
            rows.append(self._measured(x, i, order + 1))
        sensed = dict[str, np.ndarray]()
        for sensor in self.b.scene.sensors:
            names = [signal.name for signal in sensor.signals()]
            if any(signal.name in names for signal in self.outputs):
                sensed |= dict(zip(names, self._sensed(sensor), strict=True))
        forces = {id(rigid.combination): rigid.force for rigid in self.rigid}
        for k, terms in enumerate(self.held):
            (_, x, i), *_ = terms
            name = x.names[i] if isinstance(x, Touch) else forces.get(id(terms))
            if name is not None:
                sensed[name] = self._row(1)[0]
                sensed[name][3 * self.n + k] = flint.arb(1)
        for load in (x for x in self.loads.values() if x.name in self.b.wheels):
            rows_of_wheel = self._of_wheel(load, 1)
            for name, slopes in zip(("force", "force_ahead", "side_force"), rows_of_wheel, strict=True):
                sensed[f"{load.name}.{name}"] = self._row(1)[0]
                sensed[f"{load.name}.{name}"][: 3 * self.n] = slopes
            sensed[f"{load.name}.force"][-len(self.place) :] = self.unit(f"{load.name}.force")
        for soft in self.soft:
            sensed[soft.force] = self._row(1)[0]
            sensed[soft.force][: 3 * self.n] = self.soft_force(soft)
        for signal in self.outputs:
            is_measure = signal.name in measures
            rows.append(self._measured(*measures[signal.name]) if is_measure else sensed[signal.name])
        whole = poses.rows_of(rows, len(moves))
        asked, at = {s.name for s in self.asked}, self.equilibrium
        trim = {name: float(size) for name, size in at.loads.items() if name in asked}
        doubles, values = np.abs(whole.astype(float)), poses.times(whole, moves)
        assert all(x.rad() < BALL for x in values.ravel()), "too few bits"
        matrix, terms = (
            np.where(np.abs(x) > NOTHING, x, 0.0) for x in (values.astype(float), doubles @ sizes)
        )
        return Truth(matrix, terms, trim, at.missed)

    # rows of outputs by [x ; v ; a ; lambda ; e ; z] ---------------------------------------

    def _row(self, count: int) -> np.ndarray:
        return poses.zeros(count, len(self.moves[0]))

    def _measured(self, link: Link, i: int, order: int) -> np.ndarray:
        row = self._row(1)[0]
        row[: 3 * self.n] = self.at.moving[link.name][order * len(self.at.jacobian[link.name]) + i]
        return row

    def _sensed(self, sensor: Any) -> np.ndarray:
        """Rows of what a sensor measures."""
        kind, b, n = sensor.kind, self.falling, self.n
        if kind == "joint_wrench":
            return self._wrench(next(x for x in b.joints if x.name == sensor.joint))
        if kind in ("momentum", "center_of_mass"):
            return self._of_all(kind)
        k, r = b.port(sensor.port)
        rows, m = self._row(3), b.motion(k)
        if kind == "gyro":
            rows[:, : 3 * n] = self.at.of_body(
                lambda m: (m.turn.transpose() * (m.omega + b.spin)).entries(), k
            )
        elif kind == "accelerometer":
            load = b.gravity - b.fall
            rows[:, : 3 * n] = self.at.of_body(
                lambda m: (m.turn.transpose() * m.felt(r, b.spin, load)).entries(), k
            )
            shaken = poses.rows_of(
                [self.unit(f"ground.acceleration.{axis}") for axis in "xyz"], len(self.place)
            )
            rows[:, -len(self.place) :] = poses.times(poses.array(m.turn.transpose()), shaken)
        elif k >= 0:
            order = {"position": 0, "rotation": 0, "velocity": 1, "angular_rate": 1}.get(kind, 2)
            turn = poses.array(b.motion(b.index[sensor.frame]).turn.transpose())
            place = order * n + 6 * k
            if kind in ("rotation", "angular_rate", "angular_acceleration"):
                rows[:, place + 3 : place + 6] = turn
            else:
                rows[:, place : place + 3] = turn
                rows[:, place + 3 : place + 6] = -poses.times(turn, poses.array(poses.skew(m.turn * r)))
        return rows

    def _of_all(self, kind: str) -> np.ndarray:
        """Momentum (6, .) in the scene about its origin, or displacement (3, .) of the center."""
        b, n = self.b, self.n
        rows = self._row(6)
        for k, (mass, center, inertia) in enumerate(b.masses):

            def moved(m: poses.Motion, k: int = k) -> poses.Values:
                mass, center, inertia = b.masses[k]
                c = m.turn * center
                if kind == "center_of_mass":
                    return [*((m.place + c) * mass).entries(), 0, 0, 0]
                linear = (m.velocity + poses.cross(m.omega, c)) * mass
                spun = m.turn * inertia * m.turn.transpose() * m.omega
                return [*linear.entries(), *(poses.cross(m.place + c, linear) + spun).entries()]

            rows[:, : 3 * n] += self.at.of_body(moved, k)
        if kind == "center_of_mass":
            return rows[:3] / sum(mass for mass, _, _ in b.masses)
        for link, rotor in self.rotors:

            def spun(
                P: poses.Motion, C: poses.Motion, link: Link = link, rotor: Any = rotor
            ) -> poses.Values:
                m, count = P if rotor.on_parent else C, len(self.at.jacobian[link.name])
                axis, rate = m.turn * rotor.axis, link.in_time(P, C)[count + rotor.coordinate]
                return (axis * (rotor.inertia * (poses.dot(axis, m.omega) + rotor.more * rate))).entries()

            rows[3:, : 3 * n] += self.at.slopes(spun, link)
        return rows

    def _wrench(self, link: Link) -> np.ndarray:
        """Force and torque (6, .) of a joint on its child about the port, in the child's axes."""
        b, n, part = self.b, self.n, slice(6 * link.child, 6 * link.child + 6)
        J, bent = self.at.jacobian[link.name], self.at.bent[link.name]
        rows, start = self._row(6), poses.zeros(6)
        for (name, i), (force, _) in self.equilibrium.forces.items():
            if name == link.name:
                start += J[i][part] * force
                rows[:, :n] += bent[i][part] * force
        for k, terms in enumerate(self.held):
            for c, x, i in terms:
                if x is link:
                    rows[:, 3 * n + k] += J[i][part] * c
        for soft in self.soft:
            for c, x, i in soft.combination:
                if x is link:
                    rows[:, : 3 * n] += J[i][part, None] * (self.soft_force(soft) * c)
        first = 3 * n + len(self.held)
        for i, law in enumerate(link.laws):
            acts = self._row(1)[0]
            acts[: 3 * n] = -self.law_slopes(link, i)
            if link.imposed:
                acts[first + [x is link and k == i for x, k in self.imposed].index(True)] = flint.arb(1)
            else:
                acts[-len(self.place) :] = self.unit(law.effort) * law.gain
            rows += J[i][part, None] * acts
        C = b.motion(link.child)
        for (x, rotor), by in zip(self.rotors, self.rotor_slopes, strict=True):
            if x is link and not rotor.on_parent:
                start[3:] -= b.rotor_needs(link, rotor, b.motion(link.parent), C)[1:]
                rows[3:, : 3 * n] -= by[1:]
        # the arm to the port turns with the child, and so do the axes
        eta, arm = slice(part.start + 3, part.stop), C.turn * link.at
        force, torque = (
            poses.vector(start[:3]),
            poses.vector(start[3:]) - poses.cross(arm, poses.vector(start[:3])),
        )
        rows[3:] -= poses.times(poses.array(poses.skew(arm)), rows[:3])
        rows[3:, eta] += poses.array(poses.skew(torque)) - poses.array(
            poses.skew(force) * poses.skew(arm)
        )
        rows[:3, eta] += poses.array(poses.skew(force))
        back = poses.array(C.turn.transpose())
        return np.vstack([poses.times(back, rows[:3]), poses.times(back, rows[3:])])


class _Equilibrium(NamedTuple):
    """Loads and their sizes by name, forces of links with their sizes, what is missed (relative or m)."""

    loads: dict[str, Any]
    sizes: dict[str, float]
    forces: dict[tuple[str, int], tuple[Any, float]]
    missed: float
    undetermined: int
