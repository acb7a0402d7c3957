"""The strategy for tabulated lobes: all tables at once, by Levenberg-Marquardt."""

import math
from dataclasses import dataclass, fields
from typing import cast

import torch

from torchbrdf.errors import UsageError
from torchbrdf.fitting.objective import FitObjective
from torchbrdf.fitting.strategy import STRATEGIES, Outcome
from torchbrdf.fitting.tabulated_picture import PictureProblem, sees_pictures
from torchbrdf.fitting.tabulated_problem import TabulatedProblem, is_tabulated
from torchbrdf.fitting.tabulated_variables import Falling, decoded, encoded, limits
from torchbrdf.fitting.task import Task, lbfgs_fit
from torchbrdf.lobes import DistributionBased
from torchbrdf.lobes.parameter_dict import ParameterDict
from torchbrdf.losses import CombinedLoss, CompressedLoss
from torchbrdf.solvers import Solution, Status, minimize_projected_newton

# A value of a channel, in units of that of a prediction of 0, below which nothing is worth a step.
AS_GOOD_AS_0 = 1e-7
# Of a picture's cusp, and steps at most over each: what comes later is too little to see.
WIDTHS, PICTURE_STEPS = 2, 15
SEVERITY = [Status.CONVERGED, *(one for one in Status if one != Status.CONVERGED)]


@dataclass(frozen=True, repr=False)
class TabulatedFit:
    """Fit the tables of distribution-based lobes: D and F of each lobe, and the diffuse albedo, all at once.

    With F0 held each channel is a problem of its own, of which Levenberg-Marquardt moves the logarithms of all nodes;
    sums over pairs go by the cells of the tables. Tables that are not where lobes start are taken as the start; others
    are read off the data, and divided among lobes from the peak to the flank. Under a metric and a picture together
    (`CombinedLoss`) all channels are one problem, from the fit under the metric on; it is as quick, as a picture is
    linear in values and these in each table. Under any other loss that is none of single values, L-BFGS goes on from
    the fit under the compressed loss. "global" is this strategy where a model has tabulated lobes alone.

    Args:
        smooth: the weight of squared second differences of the tables' logarithms, beside a loss of 1 for a prediction
            of 0: 1e-6 fills only gaps; 1e-3 makes tables visibly smooth.
        monotone: D does not rise with theta_h.
        polish: steps at most under a loss that is none of single values.

    Raises:
        UsageError: a number below 0.

    Source: M. Ashikhmin and S. Premoze, Distribution-based BRDFs, 2007; M. M. Bagher, J. Snyder, D. Nowrouzezahrai,
    A Non-Parametric Factor Microfacet Model for Isotropic BRDFs, 2016, doi:10.1145/2907941, who fit such factors too.

    Example:
        >>> from torchbrdf.fitting import TabulatedFit
        >>> TabulatedFit(smooth=1e-3, monotone=True)
        TabulatedFit(smooth=0.001, monotone=True)
    """

    smooth: float = 1e-6
    monotone: bool = False
    polish: int = 60

    def __post_init__(self) -> None:
        for name in ("smooth", "polish"):
            value = getattr(self, name)
            if not 0 <= value < math.inf:
                raise UsageError(f"TabulatedFit: {name}: expected a finite number from 0 on, found {value}")

    def __repr__(self) -> str:
        """What is not the default: records have it as the strategy's name."""
        given = [(one.name, getattr(self, one.name)) for one in fields(self) if getattr(self, one.name) != one.default]
        return f"TabulatedFit({', '.join(f'{name}={value!r}' for name, value in given)})"

    def __call__(self, task: Task, values: ParameterDict, fit_diffuse: bool) -> Outcome:
        """Fit."""
        if not is_tabulated(task.model):
            found = " + ".join(type(part).__name__ for part in task.model.components())
            raise UsageError(f"tabulated: expected distribution_based lobes beside Lambert's term, found {found}")
        if sees_pictures(task.objective.loss):
            return self._with_picture(task, values, fit_diffuse)
        if not task.objective.loss.is_separable():
            return self._by_gradient(task, values, fit_diffuse)
        outcome = Outcome(values)
        outcome.add(*self._step(task, task.objective, values, fit_diffuse, task.max_iterations, ftol=1e-4))
        if task.full is not None:
            outcome.add(*self._step(task, task.full, outcome.values, fit_diffuse, task.max_iterations, ftol=1e-3))
        outcome.near_optimal = [0] * len(task)
        return outcome

    def _with_picture(self, task: Task, values: ParameterDict, fit_diffuse: bool) -> Outcome:
        """First under the metric alone."""
        loss = cast("CombinedLoss", task.objective.loss)
        if task.under is None:
            raise UsageError("TabulatedFit: expected a task that can be done under other losses, found one that cannot")
        outcome = self(task.under(loss.loss), values, fit_diffuse)
        for objective in (task.objective, task.full):
            if objective is not None:
                step = self._picture_step(task, objective, outcome.values, fit_diffuse)
                outcome.add(f"with the picture, {objective.describe_size()}", *step)
        return outcome

    def _picture_step(
        self, task: Task, objective: FitObjective, values: ParameterDict, fit_diffuse: bool
    ) -> tuple[ParameterDict, Solution]:
        """All tables and channels of each material, on what both parts of an objective see."""
        loss = cast("CombinedLoss", objective.loss)
        parts = loss.parts(objective.problem)
        metric = TabulatedProblem(
            task.model, values, parts.measured, loss.loss, fit_diffuse=fit_diffuse, smooth=self.smooth
        )
        problem = PictureProblem(metric, parts.seen, loss)
        lower, upper = (bound.repeat(3) for bound in limits(metric))
        x = encoded(metric, values).unflatten(0, (-1, 3)).flatten(1)
        iterations = torch.zeros(len(problem), dtype=torch.int64, device="cpu")
        for share in loss.rendered.smoothing_widths[:WIDTHS]:
            problem.width = None if share is None else share * problem.black
            found = minimize_projected_newton(
                problem, x, lower, upper, max_iterations=PICTURE_STEPS, ftol=1e-3, fmin=AS_GOOD_AS_0
            )
            x, iterations = found.x, iterations + found.iterations
        tables = decoded(metric, x.unflatten(1, (3, -1)).flatten(0, 1), values)
        return tables, Solution(x, found.value * problem.scale.to(found.value), found.status, iterations)

    def _by_gradient(self, task: Task, values: ParameterDict, fit_diffuse: bool) -> Outcome:
        """First under the compressed loss."""
        if task.under is None:
            raise UsageError("TabulatedFit: expected a task that can be done under other losses, found one that cannot")
        outcome = self(task.under(CompressedLoss()), values, fit_diffuse)
        free = task.all_free(fit_diffuse)
        free = task.parametrization([one for one in free.free if one.spec is not DistributionBased.f0])
        for objective in (task.objective, task.full):
            if objective is not None and self.polish:
                step = lbfgs_fit(objective, outcome.values, free, max_iterations=min(self.polish, task.max_iterations))
                outcome.add(f"the loss itself, {objective.describe_size()}", *step)
        return outcome

    def _step(
        self,
        task: Task,
        objective: FitObjective,
        values: ParameterDict,
        fit_diffuse: bool,
        max_iterations: int,
        ftol: float,
    ) -> tuple[str, ParameterDict, Solution]:
        """All tables, on what an objective sees."""
        problem = TabulatedProblem(
            task.model, values, objective.problem, objective.loss, fit_diffuse=fit_diffuse, smooth=self.smooth
        )
        x, iterations = encoded(problem, values), torch.zeros(len(problem), dtype=torch.int64, device="cpu")
        lower, upper = limits(problem)
        seen = Falling(problem) if self.monotone else problem
        if isinstance(seen, Falling):
            x, lower, upper = seen.encode(x), *seen.limits(lower, upper)
        for share in objective.loss.smoothing_widths:
            problem.width = None if share is None else share * problem.magnitude
            found = minimize_projected_newton(
                seen, x, lower, upper, max_iterations=max_iterations, ftol=ftol, fmin=AS_GOOD_AS_0
            )
            x, iterations = found.x, iterations + found.iterations
        x = seen.decode(x) if isinstance(seen, Falling) else x
        count = problem.channels
        status = [max(found.status[count * k : count * (k + 1)], key=SEVERITY.index) for k in range(len(task))]
        most = iterations.unflatten(0, (-1, count)).amax(1)
        return (
            f"all tables, {objective.describe_size()}",
            decoded(problem, x, values),
            Solution(x, problem.error(x), status, most),
        )


STRATEGIES.register("tabulated")(TabulatedFit())
STRATEGIES.register("tabulated_monotone")(TabulatedFit(monotone=True))
STRATEGIES.register("tabulated_smooth")(TabulatedFit(smooth=1e-3, monotone=True))
