"""The objective of the learned metric: beside a mean over pairs, sizes of what is compared of averages in bins.

Averages of f_c = sum_k color_kc s_k are the same sums of averages of the s_k: one matrix product a pass gives them and
their derivatives. What is compared of them is a few numbers, whose sizes are majorized by parabolas, as penalties are.
Components are taken to be nowhere negative.
"""

from functools import cached_property
from typing import Any

import torch
from torch import Tensor

from torchbrdf.fitting.objective.pointwise import PointwiseObjective, Sums
from torchbrdf.losses import LearnedLoss, Loss
from torchbrdf.losses.learned import Comparison, Encoded, cosines, rounded_absolute
from torchbrdf.losses.metric_file import EPSILON

# Over how much cube roots are rounded, in units of what logarithms are.
COLOR_WIDTH = 0.1


class BinnedSums(Sums):
    """Beside what every pointwise objective adds up, the sums of the responses in bins."""

    objective: "BinnedObjective"

    def __init__(self, *args: Any) -> None:
        super().__init__(*args)
        self.bins: Tensor | float = 0.0

    def add(self, samples: slice, difference: Tensor, rate: Tensor, responses: Tensor, weight: Tensor | None) -> None:
        """Add some pairs, as `Sums.add` does, and their responses to the bins they are in."""
        super().add(samples, difference, rate, responses, weight)
        self.bins = self.bins + self.objective.binned(samples, self.materials, responses).double()

    def totals(self, jacobian: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Value, gradient and matrix, as `Sums.totals` gives them of single values, with those of the averages."""
        objective, constants = self.objective, self.objective.constants
        share = constants[3] / self._own(objective.encoded.total)
        value, gradient, matrix = super().totals(jacobian)
        value, gradient = value * share, gradient * share[:, None]
        matrix = matrix * share[:, None, None] if self.curvature else matrix

        comparison, target = self._comparison(), objective.target_code
        responses = (self.bins / comparison.bins.mass[:, :, None]).expand(-1, 3, -1, -1)  # (m, 3, Q, B)
        components = responses[:, :, responses.shape[2] - self.albedos.shape[2] :]
        averages = torch.einsum("rck,rckb->rcb", self.albedos.double(), components)
        slopes = torch.einsum("rcqb,rcqp->rcbp", responses[:, :, : self.used], jacobian)
        brightness = (comparison.channel_luminance @ averages)[:, 0] + EPSILON
        bright_slopes = torch.einsum("rxc,rcbp->rpb", comparison.channel_luminance, slopes) / brightness[:, None]
        gloss = ((brightness.log() - self._own(target.luminance)) * comparison.gloss).sum(-1)
        gloss_slopes = (bright_slopes * comparison.gloss[:, None]).sum(-1)
        color = averages + EPSILON
        root, weight = color.pow(1 / 3), comparison.chroma[:, None]
        chroma = comparison.channel_chroma @ ((root - self._own(target.color)) * weight).sum(-1, keepdim=True)
        root_slopes = (root * weight / (3 * color))[..., None] * slopes
        chroma_slopes = comparison.channel_chroma @ root_slopes.sum(2)

        bins = color.log() - self._own(target.logs)
        bins = bins * comparison.channel
        bin_slopes = ((slopes / color[..., None]) * comparison.channel[..., None]).movedim(-1, 1)

        width = None if self.width is None else self.width[:, 0].double()  # (m, 1)
        for found, slope, weight, over in (
            (gloss[:, None, None], gloss_slopes[..., None, None], constants[0], width),
            (chroma, chroma_slopes.mT[..., None], constants[1], None if width is None else COLOR_WIDTH * width),
            (bins, bin_slopes, constants[2] * comparison.even, width),
        ):
            parts = _size(found, slope, weight, over, self.curvature)
            value, gradient = value + parts[0], gradient + parts[1]
            matrix = matrix + parts[2] if self.curvature else matrix
        return value, gradient, matrix

    def _comparison(self) -> Comparison:
        bins, *others = self.objective.comparison
        own = [self._own(x) for x in others]
        return Comparison(bins._replace(mass=self._own(bins.mass)), *own)

    def _own(self, values: Tensor) -> Tensor:
        """What belongs to these materials."""
        return values if self.materials is None or len(values) == 1 else values[self.materials]


def _size(
    found: Tensor, slopes: Tensor, weight: Tensor, width: Tensor | None, curvature: bool
) -> tuple[Tensor, Tensor, Tensor]:
    """The weighted sum of lengths of vectors, with its gradient and the matrix of its majorizer.

    found: J vectors of C numbers, `(m, C, J)`; slopes: `(m, P, C, J)`; weight: `(m|1, J)`, or one; width: `(m, 1)`.
    """
    size, _, curve = rounded_absolute(found.square().sum(1).sqrt(), width)
    curve = (weight * curve)[:, None].expand_as(found).flatten(1)
    flat = slopes.flatten(2)
    gradient = (flat @ (curve * found.flatten(1))[..., None])[..., 0]
    if not curvature:
        return (weight * size).sum(1), gradient, gradient.new_empty(0)
    return (weight * size).sum(1), gradient, (flat * curve[:, None]) @ flat.mT


class BinnedObjective(PointwiseObjective):
    """The learned distance; bins divide for themselves, so that the norm is 1."""

    sums = BinnedSums
    loss: LearnedLoss

    @staticmethod
    def applies(loss: Loss) -> bool:
        """Whether it is the learned metric, with an encoding of one value at a time."""
        return isinstance(loss, LearnedLoss) and loss.is_elementwise()

    @cached_property
    def comparison(self) -> Comparison:
        """How averages in bins are compared."""
        return self.loss.comparison(self.problem.pairs, self.problem.weight, self.problem.target)

    @property
    def target_code(self) -> Encoded:
        """What is compared of the targets' averages; `encoded` has their single values, channels first."""
        return self._target_and_zero[0]

    @property
    def zero_prediction_error(self) -> Tensor:
        """The distance of a prediction that is 0 everywhere."""
        return self._target_and_zero[1]

    @cached_property
    def _target_and_zero(self) -> tuple[Encoded, Tensor]:
        problem, loss, comparison = self.problem, self.loss, self.comparison
        with torch.no_grad():
            target = loss.encoded(problem.target, problem.pairs, comparison)
            zero = loss.encoded(torch.zeros_like(problem.target[:1]), problem.pairs, comparison)
            found = comparison.terms(zero, target) @ self.constants
        return target._replace(values=target.values[:, :0].clone()), torch.where(found > 0, found, 1)

    @cached_property
    def constants(self) -> Tensor:
        """Those of the loss, where the problem is."""
        return self.loss.constants.to(self.problem.target.device)

    @property
    def target_scale(self) -> Tensor:
        """1: what is compared is logarithms, or nearly."""
        return torch.ones_like(self.encoded.total)

    @property
    def norm(self) -> Tensor:
        """Bins divide for themselves."""
        return torch.ones_like(self.encoded.total)

    @cached_property
    def _exposure(self) -> Tensor:
        """What makes of a response its x, times the weight of each pair, `(M|1, 1|3, N)`."""
        exposure = self.loss.scale * cosines(self.problem.pairs)
        weight = self.problem.weight
        return (exposure if weight is None else exposure * weight).mT

    def binned(self, samples: slice, materials: Tensor | None, responses: Tensor) -> Tensor:
        """Sums of responses `(m, Q, n)`, as x, in the bins, `(m, 1|3, Q, B)`."""
        exposure, shares = self._exposure[..., samples], self.comparison.bins.shares[:, samples]
        if materials is not None:
            exposure = exposure[materials] if len(exposure) > 1 else exposure
            shares = shares[materials] if len(shares) > 1 else shares
        columns = exposure[..., None] * shares[:, None]
        if len(columns) == 1 and columns.shape[1] == 1:
            return (responses.flatten(0, 1) @ columns[0, 0]).unflatten(0, responses.shape[:2])[:, None]
        return responses[:, None] @ columns
