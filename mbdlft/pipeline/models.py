"""The front doors: a scene or a matrix to a certified model, with the seconds of each stage."""

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

from mbdlft.base.arguments import arguments_checked
from mbdlft.base.errors import SceneError, SizeError
from mbdlft.base.parameter import Parameter
from mbdlft.base.running import one_thread
from mbdlft.matrix import MatrixProblem, matrix_problem
from mbdlft.matrix.relations import problem_of_matrix
from mbdlft.multibody.scene import Scene
from mbdlft.multibody.scene.checks import extreme_quantities
from mbdlft.multibody.to_problem import problem_of_scene
from mbdlft.order.work import SEARCH, Budget
from mbdlft.pipeline.forms import candidates, degrees
from mbdlft.pipeline.stages import realization
from mbdlft.system.model import LFTModel
from mbdlft.system.regular import PROVE, check_work
from mbdlft.system.truncation import check_tolerance
from mbdlft.system.truncation import truncate as truncated


@dataclass(frozen=True, slots=True)
class Build:
    """A model and the seconds of each stage that made it."""

    model: LFTModel
    seconds: dict[str, float]


Progress = Callable[[str], object] | None  # is told the name of each stage as it starts


@dataclass(slots=True)
class Clock:
    """Seconds by stage."""

    progress: Progress
    seconds: dict[str, float] = field(default_factory=dict)

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        if self.progress is not None:
            self.progress(name)
        start = time.perf_counter()
        yield
        self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - start


def _budget(search: float, seconds: float | None) -> Budget:
    """A SceneError if one of the two is not a size."""
    if not isinstance(search, int | float) or not search >= 0.0:
        raise SceneError(f"search: expected units of work, 0 for no search, got {search!r}.")
    if seconds is not None and (not isinstance(seconds, int | float) or not seconds >= 0.0):
        raise SceneError(f"seconds: expected a time (s), or None for no limit, got {seconds!r}.")
    return Budget(search, seconds)


@contextmanager
def timed(
    search: float, seconds: float | None, prove: float, progress: Progress = None
) -> Iterator[tuple[Budget, Clock]]:
    """A budget of work, once its numbers are known to be usable, and a clock; algebra in one thread."""
    budget = _budget(search, seconds)
    check_work(prove)
    with one_thread():
        yield budget, Clock(progress)


@arguments_checked
def to_lft(
    scene: Scene, search: float = SEARCH, *, seconds: float | None = None, prove: float = PROVE
) -> LFTModel:
    """The exact linear model of a scene around its equilibrium, parameters left in, with certificate.

    Parameters
    ----------
    scene : Scene
    search : float
        Units of work, each about a second of one core, to look for a smaller model by using that
        parameters commute, and for a better lower bound by pairs and triples of parameters; it ends at
        once when the order meets the bound. 0: neither. Models of more than 1000 repetitions are not
        searched.
    seconds : float, optional
        Upper limit of the time of the search (s). Without one the result depends on the scene alone.
    prove : float
        Units of work, each at most about a second of one core, for the proof that the model is regular
        at every value in the ranges. It ends at once for most models; where it does not, the boxes that
        are left are in `certificate.open_boxes`, and more work may close them.

    Raises
    ------
    SceneError, NotRationalError, WellPosednessError, TrimError
        As the stages: `assemble`, `linearize`, `extract`, `certify`.
    """
    return build(scene, search, seconds=seconds, prove=prove).model


def build(
    scene: Scene,
    search: float = SEARCH,
    progress: Progress = None,
    truncate: float | None = None,
    seconds: float | None = None,
    prove: float = PROVE,
) -> Build:
    """As `to_lft`, with the seconds of each stage; `progress` is told the name of each as it starts.

    With a number for `truncate` the model is truncated to that tolerance [1], as by
    `mbdlft.truncate(model, tolerance)`.

    Linear algebra runs in one thread.
    """
    if truncate is not None:
        check_tolerance(truncate)  # before the work, not after it
    with timed(search, seconds, prove, progress) as (budget, clock):
        try:
            model = realization(problem_of_scene(scene, clock.stage), budget, clock.stage, prove)
        except SizeError:
            raise SceneError(
                f"scene {scene.name!r}: its model has numbers that are too large, or too small, for "
                f"doubles. Farthest from 1 is {extreme_quantities(scene)}. Give values that are nearer "
                "to 1, or zero."
            ) from None
        if truncate is not None:
            with clock.stage("truncate"):
                model = truncated(model, truncate)
    return Build(model, clock.seconds)


@arguments_checked
def realize(
    matrix: Any,
    parameters: Sequence[Parameter] = (),
    *,
    search: float = SEARCH,
    seconds: float | None = None,
    prove: float = PROVE,
    **fields: Any,
) -> LFTModel:
    """The exact LFT of a matrix that is rational in parameters, with certificate.

    Parameters
    ----------
    matrix : rows of numbers or expressions, CasADi SX, or `MatrixProblem`
        An SX matrix has symbols named like the parameters.
    parameters : sequence of `Parameter` and `Angle`
        A name is the value in the unit of its parameter; nothing is converted. An angle stands in sin
        and cos only.
    search : float
        Units of work, each about a second of one core, to look for a smaller model by using that
        parameters commute, and for a better lower bound by pairs and triples of parameters; 0: neither.
    seconds : float, optional
        Upper limit of the time of the search (s). Without one the result depends on the matrix alone.
    prove : float
        Units of work for the proof that the model is regular in the whole range, as in `to_lft`.
    fields
        Other fields of `MatrixProblem`: name, description, constants, expressions, states, inputs,
        outputs; for an SX matrix also `symbols`, a mapping of names of parameters to its symbols.

    Returns
    -------
    LFTModel
        Value of its LFT = matrix. Without states it is static; with n states the leading n x n part is
        A, and the matrix is [A B ; C D].

    Raises
    ------
    WellPosednessError
        A denominator vanishes in the range.
    """
    if isinstance(matrix, MatrixProblem):
        if parameters or fields:
            raise SceneError(
                f"matrix {matrix.name!r}: a MatrixProblem has its own parameters and fields; give "
                "search, seconds and prove only."
            )
        problem = matrix
    else:
        problem = matrix_problem(matrix, parameters, **fields)
    return build_matrix(problem, search, seconds=seconds, prove=prove).model


def build_matrix(
    problem: MatrixProblem,
    search: float = SEARCH,
    *,
    progress: Progress = None,
    seconds: float | None = None,
    prove: float = PROVE,
) -> Build:
    """As `realize`, with the seconds of each stage; `progress` is told the name of each as it starts."""
    with timed(search, seconds, prove, progress) as (budget, clock):
        posed = problem_of_matrix(problem, clock.stage)
        return Build(realization(posed, budget, clock.stage, prove), clock.seconds)


@arguments_checked
def exact_lower_bound(problem: MatrixProblem, seed: int = 0) -> dict[str, int]:
    """Proved minimum of the repetitions of each parameter in any exact LFT of a matrix.

    Parameters
    ----------
    problem : MatrixProblem
    seed : int
        Of the residues that are drawn.

    Returns
    -------
    mapping of names to McMillan degrees, in exact arithmetic

    Raises
    ------
    SceneError, NotRationalError, WellPosednessError
        As `realize`.
    """
    with one_thread():
        posed = problem_of_matrix(problem)
        (candidate,) = candidates(posed, posed.forms[:1])
        return degrees(candidate, seed)
