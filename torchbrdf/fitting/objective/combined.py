"""The objective of a metric and a picture together: the sum of theirs, each on its own pairs."""

from functools import cached_property
from typing import cast

import torch
from torch import Tensor

from torchbrdf.fitting.basis import Basis
from torchbrdf.fitting.objective.base import GaussNewtonObjective
from torchbrdf.fitting.objective.binned import BinnedObjective
from torchbrdf.fitting.objective.image import ImageObjective
from torchbrdf.fitting.objective.pointwise import PointwiseObjective
from torchbrdf.lobes.parameter_dict import ParameterDict
from torchbrdf.losses import CombinedLoss, Loss, Problem

# What a metric beside a picture can be.
METRICS: dict[str, type[GaussNewtonObjective]] = {"pointwise": PointwiseObjective, "binned": BinnedObjective}

# A value, in units of that of a prediction of 0, whose root has no slope that is worth following.
_AS_GOOD_AS_0 = 1e-16


class CombinedObjective(GaussNewtonObjective):
    """`CombinedLoss` of errors: roots are taken of each part, and the parabola of a root lies above it.

    `problem` is the metric's, by which starts are compared; `scored` that of both.
    """

    ftol = 1e-6
    fmin = 1e-8
    loss: CombinedLoss

    def __init__(self, problem: Problem, loss: CombinedLoss) -> None:
        one, other = loss.parts(problem)
        self._set(METRICS[loss.loss.objective](one, loss.loss), ImageObjective(other, loss.rendered), loss)
        self._scored = problem

    def _set(self, metric: GaussNewtonObjective, image: GaussNewtonObjective, loss: CombinedLoss) -> None:
        super().__init__(metric.problem, loss)
        self.metric, self.image = metric, image

    def _replaced(self, metric: GaussNewtonObjective, image: GaussNewtonObjective) -> "CombinedObjective":
        """The same with other parts, whose losses can be others too."""
        made = CombinedObjective.__new__(CombinedObjective)
        image_loss = cast("ImageObjective", image).loss
        made._set(metric, image, CombinedLoss(metric.loss, image_loss, self.loss.factor, self.loss.reduction))
        return made

    @property
    def scored(self) -> Problem:
        """The problem of both, as they were given."""
        return self._scored

    @staticmethod
    def applies(loss: Loss) -> bool:
        """Whether the metric has an objective with curvature."""
        kind = METRICS.get(cast("CombinedLoss", loss).loss.objective)
        return kind is not None and kind.applies(cast("CombinedLoss", loss).loss)

    @cached_property
    def zero_prediction_error(self) -> Tensor:
        """The error of a prediction that is 0 everywhere."""
        one, other = (part.loss.finalize(part.zero_prediction_error) for part in (self.metric, self.image))
        return one + self.loss.factor * other

    @property
    def target_scale(self) -> Tensor:
        """1: widths are in units of each part's own."""
        return torch.ones_like(self.metric.target_scale)

    @property
    def target(self) -> Tensor:
        """The metric's."""
        return self.metric.target

    def observe(self, responses: Tensor) -> Tensor:
        """As the metric has it."""
        return self.metric.observe(responses)

    def curvature_at(self, prediction: Tensor) -> Tensor:
        """The metric's."""
        return self.metric.curvature_at(prediction)

    def describe_size(self) -> str:
        """What either sees."""
        return f"{self.metric.describe_size()}, {self.image.describe_size()}"

    def select(self, material: int) -> "CombinedObjective":
        """The same for one material."""
        return self._replaced(self.metric.select(material), self.image.select(material))

    def subsample(self, samples: int, seed: int) -> "CombinedObjective":
        """The same on some of the measured pairs."""
        return self._replaced(self.metric.subsample(samples, seed), self.image)

    def coarse(self, samples: int) -> "CombinedObjective":
        """On few measured pairs, and a share of the picture."""
        return self._replaced(self.metric.coarse(samples), self.image.coarse(samples))

    def surrogate(self) -> "CombinedObjective":
        """With parts that have curvature."""
        metric, image = self.metric.surrogate(), self.image.surrogate()
        return self if metric is self.metric and image is self.image else self._replaced(metric, image)

    def evaluate(
        self,
        basis: Basis,
        values: ParameterDict,
        materials: Tensor,
        scale: Tensor,
        width: Tensor | None = None,
        curvature: bool = False,
    ) -> tuple[Tensor, Tensor, Tensor]:
        """The sum of both parts'."""
        found = []
        for part, factor in ((self.metric, 1.0), (self.image, self.loss.factor)):
            unit = part.zero_prediction_error[materials] if part.loss.is_root else torch.ones_like(scale)
            own = _part_width(part, materials, width)
            value, gradient, matrix = part.evaluate(basis, values, materials, unit, own, curvature)
            share = factor / scale
            if part.loss.is_root:
                root = value.clamp_min(_AS_GOOD_AS_0).sqrt()
                # The parabola of a root lies nowhere below it, as a root's curvature is none above 0.
                value, rate = root * unit.sqrt() * share, 0.5 / root * unit.sqrt() * share
            else:
                value, rate = value * share, share
            found.append((value, gradient * rate[:, None], matrix * rate[:, None, None] if curvature else matrix))
        value, gradient, matrix = (one + other for one, other in zip(*found, strict=True))
        return value, gradient, matrix


def _part_width(part: GaussNewtonObjective, materials: Tensor, width: Tensor | None) -> Tensor | None:
    """Over which a part's cusp is rounded, from the width in units of the first of the part's own; never its last."""
    first, last = part.loss.smoothing_widths[0], part.loss.smoothing_widths[-1]
    if width is None or first is None or last is None:
        return None
    return (first * width).clamp_min(last) * part.target_scale[materials]
