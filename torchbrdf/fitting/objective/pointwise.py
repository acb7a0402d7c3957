"""The objective of a mean over pairs of penalties, penalty(encode(f) - encode(target)).

All derivatives follow from the responses of the basis: no graph, a handful of passes over pairs that lie in the
processor's cache, and sums over pairs as matrix products.
"""

from functools import cached_property

import torch
from torch import Tensor

from torchbrdf.fitting import channels
from torchbrdf.fitting.basis import Basis
from torchbrdf.fitting.objective.base import GaussNewtonObjective
from torchbrdf.fitting.sampling import Chunks, chunked
from torchbrdf.lobes.parameter_dict import ParameterDict
from torchbrdf.losses import Loss, Problem


class EncodedProblem:
    """A problem under a loss: targets encoded once, channels before pairs.

    target: `(M, 3, N)`; weight: `(M|1, 1|3, N)` or None; total: the sum of weights over pairs and channels, `(M,)`;
    zero_penalty: the mean penalty of a prediction that is 0 everywhere, `(M,)`; target_scale: the mean of the encoded
    targets' magnitude, `(M,)`, 1 where that is 0 or there is no data, so that it can serve as a unit.
    """

    def __init__(self, problem: Problem, loss: Loss, weight: Tensor | None) -> None:
        materials, count = problem.target.shape[:2]
        self.weight = weight
        self.target = problem.target.new_empty(materials, 3, count)
        sums = torch.zeros(3, materials, dtype=torch.float64, device=self.target.device)
        for part, pairs in chunked(problem.pairs, materials):
            own = problem.target[:, part].mT.contiguous()
            encoded = channels.encode(loss, own, pairs)
            zero = loss.penalty(channels.encode(loss, torch.zeros_like(own), pairs) - encoded)
            self.target[..., part] = encoded
            counted = torch.ones_like(own[:1, :1]) if weight is None else weight[..., part]
            counted = counted.expand(materials, 3, own.shape[2])
            sums += torch.stack([x.sum((1, 2)).double() for x in (counted, zero * counted, encoded.abs() * counted)])
        self.total, zeros, size = sums
        self.target_scale = torch.where(size > 0, size / self.total, 1)
        self.zero_penalty = zeros / self.total

    def part(self, samples: slice, materials: Tensor | None) -> tuple[Tensor, Tensor | None]:
        """Targets and weights of some samples, for these materials."""
        target = self.target[..., samples]
        weight = None if self.weight is None else self.weight[..., samples]
        if materials is not None:
            target = target[materials]
            weight = weight[materials] if weight is not None and len(weight) > 1 else weight
        return target, weight


class Sums:
    """What a pass over the pairs adds up for m problems: value, and derivatives by the responses in use.

    materials: of which each problem is, None: all; used: how many responses are in use; albedos: the colours of the
    components, `(m, 3, K)`; width: over which a cusp is rounded, `(m, 1, 1)`; curvature: whether a matrix is wanted.
    """

    def __init__(
        self,
        objective: "PointwiseObjective",
        materials: Tensor | None,
        used: int,
        albedos: Tensor,
        width: Tensor | None,
        curvature: bool,
    ) -> None:
        self.objective, self.materials, self.used = objective, materials, used
        self.albedos, self.width, self.curvature = albedos, width, curvature
        self.value = torch.zeros(len(albedos), dtype=torch.float64, device=albedos.device)
        self.slopes = self.value.new_zeros(len(albedos), 3, used)
        self.grams: Tensor | None = None

    def add(self, samples: slice, difference: Tensor, rate: Tensor, responses: Tensor, weight: Tensor | None) -> None:
        """Some pairs: encoded differences and the rates of encoding `(m, 3, n)`, all responses `(m, Q, n)`."""
        basis = responses[:, : self.used]
        penalty, slope, curve = self.objective.loss.penalty_with_derivatives(difference, self.width)
        if weight is not None:
            penalty, slope, curve = penalty * weight, slope * weight, curve * weight
        self.value += penalty.sum((1, 2)).double()
        self.slopes += torch.bmm(slope * rate, basis.mT).double()
        if self.curvature:
            curve = (curve * rate.square()).expand(len(basis), -1, basis.shape[2])
            curved = (curve[:, :, None] * basis[:, None]).flatten(1, 2)
            gram = torch.bmm(curved, basis.mT).double()
            self.grams = gram if self.grams is None else self.grams + gram

    def totals(self, jacobian: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Value, gradient and matrix (empty, if there is no curvature); jacobian: `(m, 3, q, P)`."""
        gradient = torch.einsum("rcq,rcqp->rp", self.slopes, jacobian)
        if not self.curvature:
            return self.value, gradient, gradient.new_empty(0)
        if self.grams is None:  # no pair at all
            return self.value, gradient, gradient.new_zeros(*gradient.shape, gradient.shape[1])
        grams = self.grams.unflatten(1, (-1, self.grams.shape[2])).expand(-1, 3, -1, -1)
        return self.value, gradient, torch.einsum("rcqp,rcqs->rps", jacobian, grams @ jacobian)


class PointwiseObjective(GaussNewtonObjective):
    """The mean of penalties over pairs and channels."""

    sums: type[Sums] = Sums

    @staticmethod
    def applies(loss: Loss) -> bool:
        """Whether the loss works on one value at a time."""
        return loss.is_elementwise()

    @cached_property
    def encoded(self) -> EncodedProblem:
        """The problem, laid out for speed."""
        weight = channels.effective_weight(self.loss, self.problem.pairs, self.problem.weight)
        return EncodedProblem(self.problem, self.loss, weight)

    @cached_property
    def chunks(self) -> Chunks:
        """The pairs in parts."""
        return Chunks(self.problem.pairs)

    @cached_property
    def zero_prediction_error(self) -> Tensor:
        """The mean penalty of a prediction that is 0 everywhere."""
        return torch.where(self.encoded.zero_penalty > 0, self.encoded.zero_penalty, 1)

    @property
    def target_scale(self) -> Tensor:
        """The mean magnitude of encoded targets."""
        return self.encoded.target_scale

    @property
    def norm(self) -> Tensor:
        """What sums are divided by, `(M,)`."""
        return self.encoded.total

    @property
    def target(self) -> Tensor:
        """The measured values."""
        return self.problem.target.mT.double()

    def observe(self, responses: Tensor) -> Tensor:
        """Scalar functions as they are, the same for all channels."""
        return responses[None]

    def curvature_at(self, prediction: Tensor) -> Tensor:
        """The curvature of the penalty, through the encoding."""
        encoded, dtype = self.encoded, self.problem.target.dtype
        code, rate = channels.encode_with_derivative(self.loss, prediction.to(dtype), self.problem.pairs)
        share = self.loss.smoothing_widths[0]
        width = None if share is None else (share * encoded.target_scale)[:, None, None].to(dtype)
        _, _, curve = self.loss.penalty_with_derivatives(code - encoded.target, width)
        curve = (curve * rate.square()).double()
        return curve if encoded.weight is None else curve * encoded.weight

    def evaluate(
        self,
        basis: Basis,
        values: ParameterDict,
        materials: Tensor,
        scale: Tensor,
        width: Tensor | None = None,
        curvature: bool = False,
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Value, gradient and matrix, in one pass over the pairs."""
        dtype, problems = self.problem.target.dtype, len(materials)
        rows = None if self.is_every_material(materials) else materials
        albedos = basis.albedos(values, dtype)
        width = None if width is None else width[:, None, None].to(dtype)
        sums = self.sums(self, rows, basis.used, albedos, width, curvature)
        for part, pairs in self.chunks(problems):
            if pairs.shape[0] > 1 and rows is not None:
                pairs = pairs.select(rows)
            responses = basis.stacked(pairs, values, dtype, problems)
            target, weight = self.encoded.part(part, rows)
            code, rate = channels.encode_with_derivative(self.loss, basis.predict(albedos, responses), pairs)
            sums.add(part, code - target, rate, responses, weight)
        value, gradient, matrix = sums.totals(basis.jacobian(values, albedos.double()))
        norm = self.norm.expand(len(self))[materials] * scale
        matrix = matrix / norm[:, None, None] if curvature else matrix
        return value / norm, gradient / norm[:, None], matrix
