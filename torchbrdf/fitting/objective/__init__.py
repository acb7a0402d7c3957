"""What a fit minimises: one kind of objective for each kind of loss, by the name that `Loss.objective` has."""

from torchbrdf.errors import UsageError
from torchbrdf.fitting.basis import is_separable
from torchbrdf.fitting.objective.autograd import AutogradObjective
from torchbrdf.fitting.objective.base import FitObjective, GaussNewtonObjective
from torchbrdf.fitting.objective.binned import BinnedObjective
from torchbrdf.fitting.objective.combined import CombinedObjective
from torchbrdf.fitting.objective.image import ImageObjective
from torchbrdf.fitting.objective.pointwise import PointwiseObjective
from torchbrdf.fitting.objective.quadratic import QuadraticObjective
from torchbrdf.lobes import Lobe
from torchbrdf.losses import Loss, Problem

OBJECTIVES: dict[str, type[FitObjective]] = {
    "pointwise": PointwiseObjective,
    "binned": BinnedObjective,
    "image": ImageObjective,
    "combined": CombinedObjective,
    "autograd": AutogradObjective,
}

__all__ = [
    "OBJECTIVES",
    "FitObjective",
    "GaussNewtonObjective",
    "QuadraticObjective",
    "make_objective",
]


def make_objective(model: Lobe, problem: Problem, loss: Loss) -> FitObjective:
    """The objective of a loss on a problem; by autograd, where the model or the loss has not the form of its kind.

    Raises:
        UsageError: for a kind of objective that does not exist.
    """
    if loss.objective not in OBJECTIVES:
        expected = ", ".join(OBJECTIVES)
        raise UsageError(f"{type(loss).__name__}.objective: expected one of {expected}, found {loss.objective!r}")
    kind = OBJECTIVES[loss.objective]
    fits = is_separable(model) and kind.applies(loss)
    return (kind if fits else AutogradObjective)(problem, loss)
