"""The front doors of DAEs, which take scipy's optimization: other models are made without it."""

from collections.abc import Mapping, Sequence

from mbdlft.base.arguments import arguments_checked
from mbdlft.dae.dae import Dae
from mbdlft.dae.equilibria import DaeTrim, trim
from mbdlft.dae.linear import problem_of_trim
from mbdlft.dae.structure import Structure, reduce_index
from mbdlft.dae.theta.separation import Arrange
from mbdlft.dae.to_problem import problem_of_dae
from mbdlft.order.work import SEARCH
from mbdlft.pipeline.models import Progress, timed
from mbdlft.pipeline.stages import realization
from mbdlft.system.model import LFTModel
from mbdlft.system.regular import PROVE
from mbdlft.system.theta import DeltaThetaModel


@arguments_checked
def delta_theta(
    model: Dae | Structure,
    arrange: Arrange = "fewest",
    *,
    search: float = SEARCH,
    seconds: float | None = None,
    prove: float = PROVE,
    progress: Progress = None,
) -> DeltaThetaModel:
    """The exact Delta-Theta form of a DAE, nothing linearized; its linear part has a certificate.

    xdot = A x + B_w w + B_zeta zeta + B_u u, ..., w = Delta z, zeta = Theta(omega)

    Parameters
    ----------
    model : Dae, or Structure
        A structure has the states that were asked for.
    arrange : {"fewest", "blocks"}
        Functions with as few inputs as possible; or of the signals of the equations as they are.
    search, seconds, prove
        As in `to_lft`.
    progress : function, optional
        Is told the name of each stage as it starts.

    Raises
    ------
    StructureError
        As `reduce_index`.
    TrimError
        A variable is outside its minimum and maximum at the initial point.
    NotRationalError
        A coefficient is not rational in the parameters.
    """
    with timed(search, seconds, prove, progress) as (budget, clock):
        with clock.stage("structure"):
            structure = model if isinstance(model, Structure) else reduce_index(model)
        separated = problem_of_dae(structure, arrange, clock.stage)
        linear = realization(separated.problem, budget, clock.stage, prove)
    return DeltaThetaModel(
        linear, separated.functions, separated.has_one, separated.initial, separated.zeta
    )


@arguments_checked
def linearize_dae(
    model: Dae | Structure | DaeTrim,
    at: Mapping[str, float | str] | None = None,
    free: Sequence[str] = (),
    *,
    fit: float | None = None,
    search: float = SEARCH,
    seconds: float | None = None,
    prove: float = PROVE,
    progress: Progress = None,
) -> LFTModel:
    """The exact linear model of a DAE around an equilibrium, parameters left in, with certificate.

    Parameters
    ----------
    model : Dae, Structure, or DaeTrim
        Of the last the equilibrium is known; the others are trimmed.
    at, free, fit
        As in `trim`.
    search, seconds, prove
        As in `to_lft`.
    progress : function, optional
        Is told the name of each stage as it starts.

    Raises
    ------
    StructureError, TrimError, NotRationalError
        As `reduce_index`, `trim`; or the linear model is not rational in the parameters.
    """
    with timed(search, seconds, prove, progress) as (budget, clock):
        if not isinstance(model, DaeTrim):
            with clock.stage("structure"):
                structure = model if isinstance(model, Structure) else reduce_index(model)
            with clock.stage("trim"):
                model = trim(structure, at, free, fit=fit)
        return realization(problem_of_trim(model, clock.stage), budget, clock.stage, prove)
