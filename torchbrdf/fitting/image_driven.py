"""The image-driven strategy: fits under several metrics, of which the nearest is kept."""

from collections.abc import Sequence
from dataclasses import dataclass, fields

import torch

from torchbrdf.errors import UsageError
from torchbrdf.fitting.global_search import GlobalSearch
from torchbrdf.fitting.objective import GaussNewtonObjective
from torchbrdf.fitting.scoring import errors
from torchbrdf.fitting.strategy import STRATEGIES, Outcome, Stage, Strategy
from torchbrdf.fitting.task import Task, lbfgs_fit, levenberg_marquardt_fit
from torchbrdf.lobes.parameter_dict import ParameterDict, with_parameters
from torchbrdf.losses import LOSSES, CompressedLoss, Loss, as_loss, make_loss

SEARCH = GlobalSearch()
# Powers of f cos_i from the root to nearly the logarithm, a family such as Bieron and Peers have, and what is apart.
METRICS: tuple[str | Loss, ...] = (
    CompressedLoss(1 / 2), "compressed", CompressedLoss(1 / 5), CompressedLoss(1 / 10), "cube_root", "learned",
)  # fmt: skip


@dataclass(frozen=True, repr=False)
class ImageDriven:
    """Fit under several metrics of BRDF values, and keep for each material the fit that is nearest under the loss.

    The loss is what decides: with `RenderedLoss` that is how near the picture is, in any scene and under any image
    difference. A candidate is drawn once, so that the choice costs little beside the fits; and as each is a fit of the
    BRDF, none is made to the scene's measure alone. Records say which metric was `chosen`. A few steps under the loss
    itself are no longer a choice, but bring the picture nearly as near as a fit under the loss from many starts does:
    "image_driven_polished" takes three.

    Args:
        metrics: losses of BRDF values, or their registered names.
        search: how each candidate is found.
        polish: steps under the loss itself from the nearest candidate on; 0: it stays what it is.

    Raises:
        UsageError: without any metric, or for an unknown one.

    Source: J. Bieron and P. Peers, An Adaptive BRDF Fitting Metric, 2020, doi:10.1111/cgf.14054.

    Example:
        >>> from torchbrdf.fitting import ImageDriven
        >>> ImageDriven(metrics=("compressed", "log")).polish
        0
    """

    metrics: Sequence[str | Loss] = METRICS
    search: Strategy = SEARCH
    polish: int = 0

    def __post_init__(self) -> None:
        if not self.metrics:
            raise UsageError("ImageDriven: metrics: expected at least one loss, found none")
        if self.polish < 0:
            raise UsageError(f"ImageDriven: polish: expected a number of steps from 0 on, found {self.polish}")
        for metric in self.metrics:
            _ = LOSSES[metric] if isinstance(metric, str) else as_loss(metric)  # a wrong one is said at once

    def __repr__(self) -> str:
        """What is not the default: records have it as the strategy's name."""
        given = [(one.name, getattr(self, one.name)) for one in fields(self) if getattr(self, one.name) != one.default]
        return f"ImageDriven({', '.join(f'{name}={value!r}' for name, value in given)})"

    @property
    def losses(self) -> list[Loss]:
        """The metrics as losses."""
        return [make_loss(metric) if isinstance(metric, str) else as_loss(metric) for metric in self.metrics]

    def __call__(self, task: Task, values: ParameterDict, fit_diffuse: bool) -> Outcome:
        """Fit."""
        if task.under is None:
            raise UsageError("ImageDriven: expected a task that can be done under other losses, found one that cannot")
        losses = self.losses
        candidates = [self.search(task.under(loss), values, fit_diffuse) for loss in losses]
        models = [with_parameters(task.model, found.values) for found in candidates]
        objective = task.objective if task.full is None else task.full
        error = errors(models, objective.scored, [objective.loss])[0]  # (K, M)
        nearest = error.nan_to_num(torch.inf).argmin(0)
        rows = range(len(nearest))
        picked = [candidates[k] for k in nearest.tolist()]
        outcome = Outcome(
            {name: torch.stack([picked[m].values[name][m] for m in rows]) for name in values},
            stages=[_summary(loss, found) for loss, found in zip(losses, candidates, strict=True)],
            starts=sum(found.starts for found in candidates),
            near_optimal=[picked[m].near_optimal[m] if picked[m].near_optimal else 0 for m in rows],
            chosen=[_described(losses[k]) for k in nearest.tolist()],
        )
        status = [picked[m].status(m) for m in rows]
        outcome.stages.append(Stage("the nearest", error.amin(0).tolist(), status, [0] * len(nearest)))
        if self.polish:
            self._polish(task, outcome, fit_diffuse)
        return outcome

    def _polish(self, task: Task, outcome: Outcome, fit_diffuse: bool) -> None:
        """A few steps under the loss itself; that there could be more is no failure."""
        objective, free = task.objective, task.all_free(fit_diffuse)
        if isinstance(objective, GaussNewtonObjective) and objective.surrogate() is objective:
            widths = objective.loss.smoothing_widths[-1:]
            step = levenberg_marquardt_fit(objective, outcome.values, free, max_iterations=self.polish, widths=widths)
        else:
            step = lbfgs_fit(objective, outcome.values, free, max_iterations=self.polish)
        before = outcome.stages[-1].status
        outcome.add("polished", *step)
        outcome.stages[-1].status = before


STRATEGIES.register("image_driven")(ImageDriven())
STRATEGIES.register("image_driven_polished")(ImageDriven(polish=3))


def _summary(loss: Loss, found: Outcome) -> Stage:
    """All stages of a candidate as one."""
    last = found.stages[-1]
    iterations = [sum(own) for own in zip(*(stage.iterations for stage in found.stages), strict=True)]
    return Stage(f"under {_described(loss)}", last.error, last.status, iterations)


def _described(loss: Loss) -> str:
    """The name of a loss with the arguments that are not the defaults, as several of one name may be tried."""
    rest = " ".join(loss.extra_repr().split())
    return f"{loss.registered_name}({rest})" if rest and repr(loss) != repr(type(loss)()) else loss.registered_name
