"""The objective of any loss and any model: derivatives by a graph through both."""

from dataclasses import dataclass
from functools import cached_property

import torch
from torch import Tensor

from torchbrdf.errors import UsageError
from torchbrdf.fitting.objective.base import FitObjective
from torchbrdf.fitting.parameters import Parametrization
from torchbrdf.lobes.parameter_dict import ParameterDict, take_materials
from torchbrdf.losses import Problem


class AutogradObjective(FitObjective):
    """The error of a loss, or its square where the loss says that the error is a root."""

    @cached_property
    def zero_prediction_error(self) -> Tensor:
        """The value of a prediction that is 0 everywhere."""
        problem = self.problem
        with torch.no_grad():
            found = self.value(torch.zeros_like(problem.target), problem)
        return torch.where(found > 0, found, 1)

    def bind(
        self, parametrization: Parametrization, values: ParameterDict, materials: Tensor | None = None
    ) -> "BoundAutograd":
        """R problems for a solver, without curvature."""
        return BoundAutograd(self, parametrization, values, self.material_indices if materials is None else materials)

    def value(self, prediction: Tensor, problem: Problem) -> Tensor:
        """The value of predictions `(m, N, C)` on some materials of the problem, `(m,)`, float64."""
        error = self.loss.error(prediction, problem.target, problem.pairs, problem.weight).double()
        return error.square() if self.loss.is_root else error


@dataclass
class BoundAutograd:
    """R problems under an autograd objective, as `torchbrdf.solvers` sees them."""

    objective: AutogradObjective
    parametrization: Parametrization
    values: ParameterDict
    materials: Tensor

    def value_and_gradient(self, x: Tensor, rows: Tensor) -> tuple[Tensor, Tensor]:
        """By differentiating through the model and the loss, whatever they are."""
        objective, materials = self.objective, self.materials[rows]
        own = objective.problem if objective.is_every_material(materials) else objective.problem.select(materials)
        with torch.enable_grad():
            point = x.detach().requires_grad_()
            here = take_materials(self.values, rows) | self.parametrization.decode(point, own.target.dtype)
            prediction = self.parametrization.predict(here, own.pairs).expand_as(own.target)
            value = objective.value(prediction, own) / objective.zero_prediction_error[materials]
            if not value.requires_grad:
                name = objective.loss.registered_name
                raise UsageError(f"{name}: no gradient: it does not use the prediction, or not by operations of torch")
            (gradient,) = torch.autograd.grad(value.sum(), point)
        return value.detach(), gradient
