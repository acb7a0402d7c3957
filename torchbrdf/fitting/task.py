"""What a strategy works on, and the two steps that it is made of: moving some parameters so that a loss falls."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Self

import torch
from torch import Tensor

from torchbrdf.errors import UsageError
from torchbrdf.fitting.objective import FitObjective, GaussNewtonObjective
from torchbrdf.fitting.parameters import (
    FreeParameter,
    Parametrization,
    diffuse_components,
    free_parameters,
    specular_components,
)
from torchbrdf.lobes import Lobe
from torchbrdf.lobes.parameter_dict import ParameterDict
from torchbrdf.losses import Loss
from torchbrdf.solvers import Solution, minimize_lbfgs, minimize_levenberg_marquardt


@dataclass(frozen=True)
class Task:
    """A model and what it is to come close to.

    objective: what the solver works on; full: all there is, where `objective` is a subset of it; under: the same task
    under another loss.
    """

    model: Lobe
    objective: FitObjective
    full: FitObjective | None = None
    max_iterations: int = 300
    under: Callable[[Loss], Self] | None = None

    def __len__(self) -> int:
        return len(self.objective)

    @property
    def diffuse(self) -> list[int]:
        """The diffuse components."""
        return diffuse_components(self.model)

    @property
    def specular(self) -> list[int]:
        """The others."""
        return specular_components(self.model)

    def parametrization(self, free: list[FreeParameter], components: list[int] | None = None) -> Parametrization:
        """Some free parameters, with some components present; None: all, the diffuse ones first."""
        return Parametrization(self.model, free, self.diffuse + self.specular if components is None else components)

    def all_free(self, fit_diffuse: bool) -> Parametrization:
        """All parameters that a fit moves."""
        components = self.diffuse + self.specular if fit_diffuse else self.specular
        return self.parametrization(free_parameters(self.model, components))


def lbfgs_fit(
    objective: FitObjective, values: ParameterDict, parametrization: Parametrization, *, max_iterations: int
) -> tuple[ParameterDict, Solution]:
    """Minimise an objective by L-BFGS over the free parameters of every material, from `values`.

    Returns all parameters, and the solution, whose values are errors.
    """
    scale = objective.zero_prediction_error
    lower, upper = (bound.to(scale.device) for bound in parametrization.limits())
    found = minimize_lbfgs(
        objective.bind(parametrization, values),
        parametrization.encode(values).to(scale.device),
        lower,
        upper,
        max_iterations=max_iterations,
        fmin=objective.fmin,
    )
    found.value = objective.loss.finalize(found.value * scale)
    return values | parametrization.decode(found.x, objective.problem.target.dtype), found


def levenberg_marquardt_fit(
    objective: GaussNewtonObjective,
    values: ParameterDict,
    parametrization: Parametrization,
    *,
    max_iterations: int,
    materials: Tensor | None = None,
    ftol: float = 1e-8,
    widths: tuple[float | None, ...] | None = None,
) -> tuple[ParameterDict, Solution]:
    """The same by Levenberg-Marquardt; materials: `(R,)`, of which each of R problems is; None: one of each.

    widths: over which a loss with a cusp is rounded, one after the other, in units of the mean target; the loss's own
    if None. The errors of the solution are those of the loss itself.
    """
    widths = objective.loss.smoothing_widths if widths is None else widths
    if not widths:
        raise UsageError(f"{type(objective.loss).__name__}.smoothing_widths: expected at least one, or (None,)")
    materials = objective.material_indices if materials is None else materials
    scale = objective.zero_prediction_error[materials]
    x = parametrization.encode(values).to(scale.device)
    lower, upper = (bound.to(scale.device) for bound in parametrization.limits())
    iterations = torch.zeros(len(x), dtype=torch.int64, device="cpu")
    for share in widths:
        width = None if share is None else share * objective.target_scale[materials]
        bound = objective.bind(parametrization, values, materials, width)
        found = minimize_levenberg_marquardt(
            bound, x, lower, upper, max_iterations=max_iterations, ftol=ftol, fmin=objective.fmin
        )
        x, iterations = found.x, iterations + found.iterations
    value = found.value
    if width is not None:
        value, _ = bound.value_and_gradient(x, torch.arange(len(x), dtype=torch.int64, device=x.device))
    found = Solution(x, objective.loss.finalize(value * scale), found.status, iterations)
    return values | parametrization.decode(x, objective.problem.target.dtype), found
