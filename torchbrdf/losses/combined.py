"""A metric of BRDF values and what a picture shows, in one loss."""

from typing import NamedTuple

import torch
from torch import Tensor

from torchbrdf.errors import ShapeError, UsageError
from torchbrdf.losses.base import Loss
from torchbrdf.losses.function import as_loss
from torchbrdf.losses.image import ImageLoss
from torchbrdf.losses.problem import MeasuredValues, Problem
from torchbrdf.pairs import Pairs
from torchbrdf.reduction import Reduction

# One unit of a learned metric, the mean distance of two materials, weighs as much as this many of Delta E.
EQUAL_WEIGHT = 40.0
# Widths of the parts' cusps, in units of the first of each.
WIDTHS = (1.0, 0.1, 0.01)


class CombinedLoss(Loss):
    """loss + factor * rendered: how far the BRDF's values are off, and a small picture of them.

    The picture says what matters to the eye, and the metric holds what that one scene does not show. Its problem has
    the measured pairs and, behind them, those of the picture's scene: `problem = loss.problem(measured)`, and then
    `loss(prediction, problem.target, problem.pairs, problem.weight)` with the values on `problem.pairs`. Weights count
    for the measured pairs only.

    Args:
        loss: of BRDF values.
        rendered: of a picture, such as `RenderedLoss`; 24 pixels a side will do, in a light that is not the one in
            which fits are judged.
        factor: how much one unit of the picture's error counts; 1/40 for Delta E beside a learned metric.
        reduction: as of `Loss`; those of the two parts do not matter.

    Raises:
        UsageError: for parts of another kind, or a factor that is not positive and finite.

    Example:
        >>> from torchbrdf.losses import CombinedLoss, CompressedLoss
        >>> from torchbrdf.measured import load, standins
        >>> from torchbrdf.render import RenderedLoss, Scene, sphere
        >>> picture = RenderedLoss(Scene(sphere(2), size=8, nodes=8, light_samples=4))
        >>> loss = CombinedLoss(CompressedLoss(), picture)
        >>> problem = loss.problem(load(standins()).batch([6], torch.arange(0, 1_000_000, 1000)))
        >>> loss(problem.target, problem.target, problem.pairs)
        tensor(0.)
    """

    objective = "combined"
    is_root = False
    needs_rgb = True
    default_diffuse = "fit"

    def __init__(
        self, loss: Loss, rendered: ImageLoss, factor: float = 1 / EQUAL_WEIGHT, reduction: Reduction = "mean"
    ) -> None:
        super().__init__(reduction)
        loss = as_loss(loss)
        if isinstance(loss, ImageLoss | CombinedLoss):
            raise UsageError(f"CombinedLoss: loss: expected one of BRDF values, found {loss.registered_name}")
        if not isinstance(rendered, ImageLoss):
            found = getattr(rendered, "registered_name", type(rendered).__name__)
            raise UsageError(f"CombinedLoss: rendered: expected a loss of pictures, found {found}")
        if not 0 < factor < torch.inf:
            raise UsageError(f"CombinedLoss: factor: expected a number above 0, found {factor}")
        self.loss, self.rendered, self.factor = loss, rendered, factor
        self.scene_summary = rendered.scene_summary
        cusps = [part for part in (loss, rendered) if part.smoothing_widths[0] is not None]
        self.smoothing_widths = WIDTHS if cusps else (None,)

    @property
    def registered_name(self) -> str:
        """The names of both, with a plus between."""
        return f"{self.loss.registered_name}+{self.rendered.registered_name}"

    @property
    def has_closed_derivatives(self) -> bool:
        """Whether the metric has."""
        return self.loss.objective != "autograd" and self.loss.has_closed_derivatives

    def problem(self, measured: MeasuredValues, subset: Tensor | None = None) -> Problem:
        """The measured pairs, or those that `subset` names by index, and then the scene's."""
        one, other = self.loss.problem(measured, subset), self.rendered.problem(measured)
        weight = one.weight
        if weight is not None:
            full = weight.expand(-1, len(one.pairs), -1)
            weight = torch.cat([full, torch.ones_like(full[:, :1]).expand(-1, len(other.pairs), -1)], 1)
        target = torch.cat([one.target, other.target.to(one.target)], 1)
        parts = [one.pairs, other.pairs.to(one.pairs.device, one.pairs.dtype)]
        oriented = all(part.is_oriented for part in parts)
        return Problem(Pairs.joined(parts, oriented=oriented), target, weight)

    def select(self, problem: Problem, samples: Tensor) -> Problem:
        """Some of the measured pairs, and all of the scene's."""
        count = len(problem.pairs)
        scene = torch.arange(count - len(self.rendered.pairs), count, dtype=torch.int64, device=samples.device)
        return problem.select(samples=torch.cat([samples, scene]))

    def parts(self, problem: Problem) -> "Parts":
        """The problem of the metric, and that of the picture."""
        count = len(problem.pairs) - len(self.rendered.pairs)
        if count < 1:
            raise ShapeError(f"CombinedLoss: expected more than the scene's {len(self.rendered.pairs)} pairs, "
                             f"found {len(problem.pairs)}; loss.problem(measured) makes them")  # fmt: skip
        pairs, target, weight = problem.pairs, problem.target, problem.weight
        first, last = slice(count), slice(count, None)
        if weight is not None and weight.dim() > 1 and weight.shape[-2] > 1:
            weight = weight[..., first, :]
        measured = Problem(pairs.select(samples=first), target[..., first, :], weight)
        return Parts(measured, Problem(pairs.select(samples=last), target[..., last, :]))

    def error(
        self, prediction: Tensor, target: Tensor, pairs: Pairs | None = None, weight: Tensor | None = None
    ) -> Tensor:
        """The error of each material, `(M,)`, float64, of values on the pairs of `problem`."""
        self._check(prediction, target, pairs, weight)
        if pairs is None:
            raise ShapeError("CombinedLoss: needs the pairs of its problem; loss.problem(measured) makes them")
        one, other = self.parts(Problem(pairs, target, weight))
        count = len(one.pairs)
        error = self.loss.error(prediction[..., :count, :], one.target, one.pairs, one.weight)
        return error + self.factor * self.rendered.error(prediction[..., count:, :], other.target)


class Parts(NamedTuple):
    """A combined loss's problem: what the metric sees, and what the picture does."""

    measured: Problem
    seen: Problem
