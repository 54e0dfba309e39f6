"""The largest real part and the smallest damping of the poles over the box: reached, and proved."""

from dataclasses import dataclass, field
from functools import partial

import numpy as np

from mbdlft.base.array import Array
from mbdlft.base.errors import AnalysisError, WellPosednessError
from mbdlft.robust.anytime import Asked
from mbdlft.robust.box_search import BoxSearch, cost_of, resistance, too_large
from mbdlft.robust.characteristic import Realization, is_stable_at
from mbdlft.robust.evidence import Bounds, BoxProof
from mbdlft.robust.migration import RIGHT, UNDAMPED, Aim, moving_at, push_right

_MODES, _CORNERS, _MOST = 8, 8, 60  # searches from the nominal point, from corners; points of each
_WIDER = 4.0
_NOTHING = 1e-6  # of the largest pole, or of a damping of 1: a gap need not be smaller
_INSIDE = 1.0 - 1e-15


def worst_poles(asked: Asked, model: Realization, kind: str) -> Bounds:
    """Bounds of the largest real part, or of the smallest damping."""
    if not len(model.A):
        raise AnalysisError(f"worst_case: model {asked.system.name!r} has no states, and no poles.")
    return _PoleSearch(asked, model=model, kind=kind).result()


def _aim(kind: str) -> Aim:
    return UNDAMPED if kind == "smallest damping" else RIGHT


def _is_beyond(model: Realization, kind: str, goal: float, delta: Array) -> bool:
    return bool(np.max(_aim(kind).value(moving_at(model, delta)[0].poles)) >= goal)


@dataclass(slots=True)
class _PoleSearch(BoxSearch):
    """The worst pole so far and the edge that is proved, as values of the aim, which is to be large."""

    kind: str = field(kw_only=True)
    reached: float = -np.inf
    pole: complex = complex(np.nan)
    delta: Array = field(default_factory=lambda: np.zeros(0))
    resisted: str = ""

    def search(self) -> None:
        self.reach()
        self.prove()

    @property
    def aim(self) -> Aim:
        return _aim(self.kind)

    def look(self, delta: Array) -> complex:
        """The worst pole at deltas, which is kept if none is worse."""
        poles = moving_at(self.model, delta)[0].poles
        values = self.aim.value(poles)
        worst = int(np.argmax(values))
        if values[worst] > self.reached:
            self.reached, self.pole = float(values[worst]), complex(poles[worst])
            self.delta = delta.copy()
        return complex(poles[worst])

    def reach(self) -> None:
        """Push modes from the nominal point, and the worst poles of corners."""
        q = len(self.model.sizes)
        self.delta = np.zeros(q)
        self.look(self.delta)
        poles = moving_at(self.model, np.zeros(q))[0].poles
        kept = poles[poles.imag >= 0.0]
        order = np.argsort(-self.aim.value(kept), kind="stable")[:_MODES]
        starts = [(np.zeros(q), complex(kept[k])) for k in order]
        random = np.random.default_rng(0)
        for corner in np.sign(random.uniform(-1.0, 1.0, (_CORNERS if q else 0, q))):
            try:
                starts.append((corner, self.look(corner)))
            except WellPosednessError:
                continue
        for start, pole in starts:
            try:
                self.look(push_right(self.model, start, pole, _MOST, self.aim)[0])
            except WellPosednessError:
                continue
        self.told()

    def told(self) -> None:
        if self.asked.progress is not None:
            found = self.reached, self.upper
            self.asked.progress(*(found if self.aim is RIGHT else (-self.upper, -self.reached)))

    def region(self, goal: float) -> Realization:
        """The model with the edge of a goal."""
        if self.aim is RIGHT:
            return self.model._replace(shift=goal)
        return self.model._replace(slope=-goal / float(np.sqrt(1.0 - goal * goal)))

    def prove(self) -> None:
        """Prove edges that are nearer and nearer to the worst pole."""
        self.reason = too_large(self.model)
        size = float(np.max(np.abs(np.linalg.eigvals(self.model.A)))) if self.aim is RIGHT else 1.0
        step = distance = 0.5 * self.asked.gap * max(abs(self.reached), _NOTHING * size)
        while not self.reason and self.upper - self.reached > 2.0 * step * (1.0 + 1e-9):
            goal, cost = self.reached + distance, cost_of(self.model)
            if not self.is_edge(goal):
                self.reason = "no damping is below -1, that of an unstable real pole"
                return
            if goal >= self.upper or self.used + cost > self.asked.work:
                self.reason = self.resisted or self.used_up()
                return
            model = self.region(goal)
            if not is_stable_at(model, np.zeros(len(model.sizes))):
                self.reason = "the nominal poles are not proved to be left of the edge"
                return
            before = self.reached
            if self.is_proved(model, goal):
                self.upper, distance = goal, step
            elif self.reached <= before:
                distance *= _WIDER
            self.told()

    def is_edge(self, goal: float) -> bool:
        return self.aim is RIGHT or -1.0 < goal < 1.0

    def is_proved(self, model: Realization, goal: float) -> bool:
        """Whether an edge is proved."""
        found = self.expanded(1.0, model)
        if found is None:
            return False
        outcome = self.cut(
            1.0, found, partial(_is_beyond, self.model, self.kind, goal), model=model
        )
        if outcome.log is not None:
            self.proof = BoxProof(1.0, outcome.log, shift=model.shift, slope=model.slope)
            return True
        if outcome.counterexample is not None:
            pole = self.look(outcome.counterexample)
            self.look(push_right(self.model, outcome.counterexample, pole, _MOST, self.aim)[0])
        else:
            self.resisted = resistance(outcome, 1.0, model)
        return False

    def answer(self) -> Bounds:
        moving = moving_at(self.model, self.delta)[0]
        k = int(np.argmin(np.abs(moving.poles - self.pole)))
        slope = self.aim.slope(complex(moving.poles[k]), moving.gradients[k])
        self.lower = self.reached
        if self.aim is UNDAMPED:
            edge = self.proof.slope if isinstance(self.proof, BoxProof) else -np.inf
            least = edge / float(np.hypot(1.0, edge)) if self.proof else -1.0
            self.lower, self.upper = least - abs(least) * (1.0 - _INSIDE), -self.reached
        worst, proved = (self.delta, abs(self.pole.imag)), self.proof is not None
        return self.said(self.kind, worst, slope, proved=proved, reason=self.reason)
