"""The objective of the learned metric: beside a mean over pairs, sizes of what is compared of averages in bins.

Averages of f_c = sum_k color_kc s_k are the same sums of averages of the s_k: one matrix product a pass gives them and
their derivatives. What is compared of them is a few numbers, whose sizes are majorized by parabolas, as penalties are.
Components are taken to be nowhere negative.
"""

from functools import cached_property

import torch
from torch import Tensor

from torchbrdf.fitting.objective.factored import Factors, Sums
from torchbrdf.fitting.objective.pointwise import PointwiseObjective
from torchbrdf.losses import LearnedLoss, Loss
from torchbrdf.losses.learned import Comparison, Encoded, cosines, rounded_absolute
from torchbrdf.losses.metric_file import EPSILON

# Over how much cube roots are rounded, in units of what logarithms are.
COLOR_WIDTH = 0.1


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
        """What makes of a response its x, times the weight of each pair, `(M|1, 1|C, N)`."""
        exposure = self.loss.scale * cosines(self.problem.pairs)
        weight = self.problem.weight
        return (exposure if weight is None else exposure * weight).mT

    def _binned(self, samples: slice, rows: Tensor | None, responses: Tensor) -> Tensor:
        """Sums of responses `(m, Q, n)`, as x, in the bins, `(m, 1|C, Q, B)`."""
        columns = self._columns(samples)
        columns = columns if rows is None or len(columns) == 1 else columns[rows]
        if len(columns) == 1 and columns.shape[1] == 1:
            return (responses.flatten(0, 1) @ columns[0, 0]).unflatten(0, responses.shape[:2])[:, None].double()
        return (responses[:, None] @ columns).double()

    def _columns(self, samples: slice | Tensor) -> Tensor:
        """What sums in bins are, as a matrix of some pairs, `(M|1, 1|C, n, B)`."""
        return self._exposure[..., samples, None] * self.comparison.bins.shares[:, None, samples]

    def _with_bins(self, sums: Sums, responses: Tensor, factors: Factors, rows: Tensor | None) -> Sums:
        """With the sums of the responses in the bins, from those of the factors."""
        if factors not in self._factor_bins:
            pairs, groups = self.problem.pairs, factors.layout.groups
            own = [
                factors.on(pairs.select(samples=part)) @ self._columns(part).to(torch.float64) for part in groups
            ]  # (M|1, 1|C, J, B) of each group
            self._factor_bins[factors] = torch.stack(own, 2).flatten(2, 3)
        columns = self._factor_bins[factors]
        columns = columns if rows is None or len(columns) == 1 else columns[rows]
        return sums._replace(binned=responses[:, None] @ columns)

    @cached_property
    def _factor_bins(self) -> dict[Factors, Tensor]:
        """Sums of factors in bins, made once."""
        return {}

    def _total(
        self, sums: Sums, jacobian: Tensor, albedos: Tensor, rows: Tensor | None, width: Tensor | None
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Value, gradient and matrix of single values, with those of the averages."""
        curvature = sums.grams is not None
        share = self.constants[3] / _own(self.encoded.total, rows)
        value, gradient, matrix = sums.chained(jacobian)
        value, gradient = value * share, gradient * share[:, None]
        matrix = matrix * share[:, None, None] if curvature else matrix

        comparison, target = self._comparison(rows), self.target_code
        binned = sums.binned
        if binned is None:  # not a single pair
            count = jacobian.shape[2] + albedos.shape[2]
            binned = comparison.bins.mass.new_zeros(len(albedos), 1, count, comparison.bins.mass.shape[-1])
        responses = (binned / comparison.bins.mass[:, :, None]).expand(-1, albedos.shape[1], -1, -1)  # (m, C, Q, B)
        components = responses[:, :, responses.shape[2] - albedos.shape[2] :]
        averages = torch.einsum("rck,rckb->rcb", albedos.double(), components)
        slopes = torch.einsum("rcqb,rcqp->rcbp", responses[:, :, : jacobian.shape[2]], jacobian)
        brightness = (comparison.channel_luminance @ averages)[:, 0] + EPSILON
        bright_slopes = torch.einsum("rxc,rcbp->rpb", comparison.channel_luminance, slopes) / brightness[:, None]
        gloss = ((brightness.log() - _own(target.luminance, rows)) * comparison.gloss).sum(-1)
        gloss_slopes = (bright_slopes * comparison.gloss[:, None]).sum(-1)
        color = averages + EPSILON
        root, weight = color.pow(1 / 3), comparison.chroma[:, None]
        chroma = comparison.channel_chroma @ ((root - _own(target.color, rows)) * weight).sum(-1, keepdim=True)
        root_slopes = (root * weight / (3 * color))[..., None] * slopes
        chroma_slopes = comparison.channel_chroma @ root_slopes.sum(2)

        bins = color.log() - _own(target.logs, rows)
        bins = bins * comparison.channel
        bin_slopes = ((slopes / color[..., None]) * comparison.channel[..., None]).movedim(-1, 1)

        over = None if width is None else width[:, 0].double()  # (m, 1)
        for found, slope, counted, rounded in (
            (gloss[:, None, None], gloss_slopes[..., None, None], self.constants[0], over),
            (chroma, chroma_slopes.mT[..., None], self.constants[1], None if over is None else COLOR_WIDTH * over),
            (bins, bin_slopes, self.constants[2] * comparison.even, over),
        ):
            parts = _size(found, slope, counted, rounded, curvature)
            value, gradient = value + parts[0], gradient + parts[1]
            matrix = matrix + parts[2] if curvature else matrix
        return value, gradient, matrix

    def _comparison(self, rows: Tensor | None) -> Comparison:
        bins, *others = self.comparison
        own = [_own(x, rows) for x in others]
        return Comparison(bins._replace(mass=_own(bins.mass, rows)), *own)


def _own(values: Tensor, rows: Tensor | None) -> Tensor:
    """What belongs to these materials."""
    return values if rows is None or len(values) == 1 else values[rows]
