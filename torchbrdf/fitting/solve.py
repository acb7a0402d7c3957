"""Move some parameters of a model so that a loss falls: the steps that strategies are made of."""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import torch
from torch import Tensor

from torchbrdf.fitting.columns import applies
from torchbrdf.fitting.data import Data, stratified
from torchbrdf.fitting.lbfgs import Objective, Solution, minimize
from torchbrdf.fitting.levenberg import minimize_squares
from torchbrdf.fitting.normal import SquaredError
from torchbrdf.fitting.observed import Observations, ObservedError
from torchbrdf.fitting.variables import Values, Variable, decode, encode, evaluate, limits
from torchbrdf.lobes import Lambert, Lobe
from torchbrdf.losses import Loss, ObservedLoss, Problem

# Samples that starts are tried on.
FEW = 4_000


@dataclass(frozen=True)
class Task:
    """A model, what it is to come close to, and by which loss.

    problem: what the solver works on; whole: all there is, of which `problem` may be a subset.
    """

    model: Lobe
    problem: Problem
    loss: Loss
    max_iterations: int = 300
    whole: Problem | None = None

    def __len__(self) -> int:
        return len(self.problem.target)

    @cached_property
    def analytic(self) -> bool:
        """Whether derivatives are to be had without a graph."""
        return applies(self.model, self.loss)

    @cached_property
    def data(self) -> Data | Observations:
        """The problem, laid out for an analytic task."""
        if isinstance(self.loss, ObservedLoss):
            return Observations(self.problem, self.loss)
        return Data(self.problem, self.loss)

    def error(self, *arguments: Any) -> SquaredError | ObservedError:
        """Value, gradient and curvature of an analytic task; the arguments are those of `SquaredError`."""
        data = self.data
        if isinstance(data, Observations):
            return ObservedError(self.model, data, *arguments)
        return SquaredError(self.model, data, *arguments)

    @property
    def aim(self) -> Tensor:
        """The values, or what is observed of them, that a fit aims at, `(M, 3, P)`, float64."""
        data = self.data
        target = data.target if isinstance(data, Observations) else self.problem.target
        return target.transpose(1, 2).double()

    def look(self, shapes: Tensor) -> Tensor:
        """Scalar functions of the pairs `(K, N)` as each channel sees them, `(3|1, K, P)`, float64."""
        data = self.data
        if not isinstance(data, Observations):
            return shapes[None]
        return data.loss.columns(shapes.to(data.target.dtype)).transpose(0, 1).double()

    @cached_property
    def few(self) -> "Task":
        """The same on what starts are tried on: a few samples, or a share of the observations."""
        if isinstance(self.loss, ObservedLoss):
            loss, problem = self.loss.thinned(self.problem)
            return replace(self, loss=loss, problem=problem, whole=None)
        samples = stratified(len(self.problem.pairs), FEW, 0)
        return self if samples is None else self.on(samples.to(self.problem.target.device))

    @property
    def extent(self) -> str:
        """How much the solver sees, in words."""
        if isinstance(self.loss, ObservedLoss):
            return f"{self.data.target.shape[1]} observations, {self.loss.registered_name}"
        return f"{len(self.problem.pairs)} samples"

    @property
    def precision(self) -> float:
        """How small a share of the value a solver can still see."""
        return 1e-6 if isinstance(self.loss, ObservedLoss) else 1e-8

    @property
    def negligible(self) -> float:
        """A value, in units of black's, that is as good as 0: single precision sees no smaller one."""
        return 1e-10 if isinstance(self.loss, ObservedLoss) else 1e-12

    @cached_property
    def curved(self) -> "Task":
        """The same under a loss that has a parabola, where its own has none."""
        if isinstance(self.loss, ObservedLoss) and not self.loss.curved:
            return replace(self, loss=self.loss.stand_in())
        return self

    @cached_property
    def finish(self) -> "Task":
        """The same on all samples."""
        return self if self.whole is None else replace(self, problem=self.whole, whole=None)

    def on(self, samples: Tensor) -> "Task":
        """The same on some samples of the problem, by index."""
        return replace(self, problem=self.problem.select(samples=samples), whole=None)

    def of(self, material: int) -> "Task":
        """The same for one material."""
        return replace(self, problem=self.problem.select(torch.tensor([material])), whole=None)

    @property
    def diffuse(self) -> list[int]:
        """Which parts are diffuse."""
        return [k for k, part in enumerate(self.model.components()) if isinstance(part, Lambert)]

    @property
    def specular(self) -> list[int]:
        """Which are not."""
        return [k for k, part in enumerate(self.model.components()) if not isinstance(part, Lambert)]

    @property
    def parts(self) -> list[int]:
        """All of them, the diffuse first."""
        return self.diffuse + self.specular

    @property
    def everyone(self) -> Tensor:
        """The materials, by index."""
        return torch.arange(len(self), device=self.problem.target.device)

    def moved(self, fit_diffuse: bool) -> list[Variable]:
        """All parameters that a fit moves."""
        return self.variables(self.parts if fit_diffuse else self.specular)

    def variables(self, parts: list[int]) -> list[Variable]:
        """All parameters of these parts."""
        return [
            Variable(k, one, one.size) for k in parts for one in self.model.components()[k].parameter_specs.values()
        ]


def solve(task: Task, values: Values, variables: list[Variable], parts: list[int]) -> tuple[Values, Solution]:
    """Minimise the loss by L-BFGS over `variables`, the other values held, with only these parts of the model present.

    The solver sees squared errors, which are smooth where a fit is exact, in units of what black would have.
    """
    make = _analytic if task.analytic else _graph
    objective, scale = make(task, values, variables, parts)
    lower, upper = (bound.to(scale.device) for bound in limits(variables))
    start = encode(variables, values).to(scale.device)
    found = minimize(objective, start, lower, upper, max_iterations=task.max_iterations, negligible=task.negligible)
    found.value = task.loss.figure(found.value * scale) if task.analytic else (found.value * scale).sqrt()
    return values | decode(variables, found.x, task.problem.target.dtype), found


def descend(
    task: Task,
    materials: Tensor,
    values: Values,
    variables: list[Variable],
    parts: list[int],
    *,
    max_iterations: int,
    tolerance: float = 1e-8,
    rounding: tuple[float | None, ...] | None = None,
) -> tuple[Values, Solution]:
    """`solve` by Levenberg-Marquardt, for an analytic task; `materials`, `(R,)`, says of which each problem is.

    rounding: the widths, in units of the mean target, over which a loss with a cusp is rounded, one after the other;
    the loss's own if None. The errors of the solution are those of the loss itself.
    """
    data = task.data
    scale = data.black[materials]
    x = encode(variables, values).to(scale.device)
    lower, upper = (bound.to(scale.device) for bound in limits(variables))
    iterations = torch.zeros(len(x), dtype=torch.long)
    for share in task.loss.rounding if rounding is None else rounding:
        width = None if share is None else share * data.spread[materials]
        objective = task.error(materials, values, variables, parts, scale, width)
        found = minimize_squares(
            objective,
            x,
            lower,
            upper,
            max_iterations=max_iterations,
            tolerance=tolerance,
            negligible=task.negligible,
        )
        x = found.x
        iterations += found.iterations
    found.iterations = iterations
    if width is not None:
        exact = task.error(materials, values, variables, parts, scale)
        found.value = exact(x, torch.arange(len(x), device=x.device), curvature=False)[0]
    found.value = task.loss.figure(found.value * scale)
    return values | decode(variables, x, task.problem.target.dtype), found


def _analytic(task: Task, values: Values, variables: list[Variable], parts: list[int]) -> tuple[Objective, Tensor]:
    scale = task.data.black
    error = task.error(task.everyone, values, variables, parts, scale)
    return lambda x, rows: error(x, rows, curvature=False)[:2], scale


def _graph(task: Task, values: Values, variables: list[Variable], parts: list[int]) -> tuple[Objective, Tensor]:
    """By differentiating through the model and the loss, whatever they are."""
    problem, loss = task.problem, task.loss
    black = loss.error(torch.zeros_like(problem.target), problem.target, problem.pairs, problem.weight)
    scale = torch.where(black > 0, black, 1).square()
    held = {key: value for key, value in values.items() if key[0] in parts}

    def objective(x: Tensor, rows: Tensor) -> tuple[Tensor, Tensor]:
        own = problem if len(rows) == len(task) else problem.select(rows)
        with torch.enable_grad():
            point = x.detach().requires_grad_()
            here = {key: value[rows] for key, value in held.items()} | decode(variables, point, own.target.dtype)
            prediction = evaluate(task.model, here, own.pairs, parts).expand_as(own.target)
            value = loss.error(prediction, own.target, own.pairs, own.weight).square() / scale[rows]
            (gradient,) = torch.autograd.grad(value.sum(), point)
        return value.detach(), gradient

    return objective, scale
