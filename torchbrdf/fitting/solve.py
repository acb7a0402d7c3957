"""Move some parameters of a model so that a loss falls: the step that strategies are made of."""

from dataclasses import dataclass

import torch
from torch import Tensor

from torchbrdf.fitting.lbfgs import Solution, minimize
from torchbrdf.fitting.variables import Values, Variable, decode, encode, evaluate, limits
from torchbrdf.lobes import Lobe
from torchbrdf.losses import Loss, Problem


@dataclass(frozen=True)
class Task:
    """A model, what it is to come close to, and by which loss."""

    model: Lobe
    problem: Problem
    loss: Loss
    max_iterations: int = 300

    def errors(self, values: Values, rows: Tensor, parts: list[int]) -> Tensor:
        """The error of each material in `rows` with these values (already of those rows), `(m,)`, float64."""
        problem = self.problem
        everyone = len(rows) == len(problem.target)
        pairs = problem.pairs if everyone else problem.pairs.select(rows)
        target = problem.target if everyone else problem.target[rows]
        weight = problem.weight
        if weight is not None and not everyone and len(weight) > 1:
            weight = weight[rows]
        prediction = evaluate(self.model, values, pairs, parts)
        return self.loss.error(prediction.expand_as(target), target, pairs, weight)

    def black(self) -> Tensor:
        """The error of a prediction that is 0 everywhere, `(M,)`."""
        problem = self.problem
        return self.loss.error(torch.zeros_like(problem.target), problem.target, problem.pairs, problem.weight)


def solve(task: Task, values: Values, variables: list[Variable], parts: list[int]) -> tuple[Values, Solution]:
    """Minimise the loss over `variables`, the other values held, with only these parts of the model present.

    The solver sees squared errors, which are smooth where a fit is exact, in units of what black would have.
    """
    dtype, device = task.problem.target.dtype, task.problem.target.device
    held = {key: value for key, value in values.items() if key[0] in parts}
    black = task.black()
    scale = torch.where(black > 0, black, 1)

    def objective(x: Tensor, rows: Tensor) -> tuple[Tensor, Tensor]:
        with torch.enable_grad():
            point = x.detach().requires_grad_()
            here = {key: value[rows] for key, value in held.items()} | decode(variables, point, dtype)
            value = (task.errors(here, rows, parts) / scale[rows]).square()
            (gradient,) = torch.autograd.grad(value.sum(), point)
        return value.detach(), gradient

    start = encode(variables, values).to(device)
    lower, upper = (bound.to(device) for bound in limits(variables))
    found = minimize(objective, start, lower, upper, max_iterations=task.max_iterations)
    found.value = found.value.sqrt() * scale
    return values | decode(variables, found.x, dtype), found
