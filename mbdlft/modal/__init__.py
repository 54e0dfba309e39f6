"""Finite-element data to flexible bodies: component modes, sources of matrices, catalogue bodies."""

from mbdlft.modal.body import flexible_body as flexible_body
from mbdlft.modal.body import modal_body as modal_body
from mbdlft.modal.catalogue import load_body as load_body
from mbdlft.modal.files import load_matrices as load_matrices
from mbdlft.modal.files import save_matrices as save_matrices
from mbdlft.modal.matrices import FiniteElements as FiniteElements
from mbdlft.modal.matrices import to_si as to_si
from mbdlft.modal.model import ModalModel as ModalModel
from mbdlft.modal.model import modal_model as modal_model
from mbdlft.modal.nastran import load_nastran as load_nastran
from mbdlft.modal.nodes import Interface as Interface
from mbdlft.modal.nodes import Nodes as Nodes
from mbdlft.modal.nodes import every_dof as every_dof
from mbdlft.modal.report import EffectiveMasses as EffectiveMasses
from mbdlft.modal.report import effective_masses as effective_masses
from mbdlft.modal.results import model_of_results as model_of_results
