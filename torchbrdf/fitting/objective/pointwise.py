"""The objective of a mean over pairs of penalties, penalty(encode(f) - encode(target)).

All derivatives follow from the responses of the basis: no graph, a handful of passes over pairs that lie in the
processor's cache, and sums over pairs as matrix products. Where many pairs share a half angle and no lobe knows its
shape at any other, the responses are not even evaluated on the pairs, see `factored`.
"""

from functools import cached_property

import torch
from torch import Tensor

from torchbrdf.fitting import channels
from torchbrdf.fitting.basis import Basis
from torchbrdf.fitting.objective.base import GaussNewtonObjective
from torchbrdf.fitting.objective.factored import LEAST_PAIRS, FactoredProblem, Factors, Sums
from torchbrdf.fitting.pair_factors import groups_of
from torchbrdf.fitting.sampling import Chunks, chunked
from torchbrdf.lobes.parameter_dict import ParameterDict
from torchbrdf.losses import Loss, Problem


class EncodedProblem:
    """A problem under a loss: targets encoded once, channels before pairs.

    target: `(M, C, N)`; weight: `(M|1, 1|C, N)` or None; total: the sum of weights over pairs and channels, `(M,)`;
    zero_penalty: the mean penalty of a prediction that is 0 everywhere, `(M,)`; target_scale: the mean of the encoded
    targets' magnitude, `(M,)`, 1 where that is 0 or there is no data, so that it can serve as a unit.
    """

    def __init__(self, problem: Problem, loss: Loss, weight: Tensor | None) -> None:
        materials, count, width = problem.target.shape
        self.weight = weight
        self.target = problem.target.new_empty(materials, width, count)
        sums = torch.zeros(3, materials, dtype=torch.float64, device=self.target.device)
        for part, pairs in chunked(problem.pairs, materials):
            own = problem.target[:, part].mT.contiguous()
            encoded = channels.encode(loss, own, pairs)
            zero = loss.penalty(channels.encode(loss, torch.zeros_like(own), pairs) - encoded)
            self.target[..., part] = encoded
            counted = torch.ones_like(own[:1, :1]) if weight is None else weight[..., part]
            counted = counted.expand(materials, width, own.shape[2])
            sums += torch.stack([x.sum((1, 2)).double() for x in (counted, zero * counted, encoded.abs() * counted)])
        self.total, zeros, magnitude = sums
        self.target_scale = torch.where(magnitude > 0, magnitude / self.total, 1)
        self.zero_penalty = zeros / self.total

    def part(self, samples: slice, materials: Tensor | None) -> tuple[Tensor, Tensor | None]:
        """Targets and weights of some samples, for these materials."""
        target = self.target[..., samples]
        weight = None if self.weight is None else self.weight[..., samples]
        if materials is not None:
            target = target[materials]
            weight = weight[materials] if weight is not None and len(weight) > 1 else weight
        return target, weight


class PointwiseObjective(GaussNewtonObjective):
    """The mean of penalties over pairs and channels."""

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
        dtype = self.problem.target.dtype
        rows = None if self.is_every_material(materials) else materials
        albedos = basis.albedos(values, torch.float64)
        width = None if width is None else width[:, None, None].to(dtype)
        factored = self.factored if all(part.kind.has_pair_factors() for part in basis.parts) else None
        if factored is None:
            sums = self._sums(basis, values, albedos, rows, width, curvature)
        else:
            sums, responses = factored.sums(basis, values, albedos, rows, width, curvature)
            sums = self._with_bins(sums, responses, factored.factors(basis), rows)
        found = self._total(sums, basis.jacobian(values, albedos), albedos, rows, width)
        norm = self.norm.expand(len(self))[materials] * scale
        matrix = found[2] / norm[:, None, None] if curvature else found[2]
        return found[0] / norm, found[1] / norm[:, None], matrix

    @cached_property
    def factored(self) -> FactoredProblem | None:
        """The problem by half angles; None where few pairs share one, or materials have pairs of their own."""
        groups = groups_of(self.problem.pairs, LEAST_PAIRS)
        if groups is None:
            return None
        return FactoredProblem(self.problem, self.loss, self.encoded.weight, self.encoded.target, groups)

    def _sums(
        self,
        basis: Basis,
        values: ParameterDict,
        albedos: Tensor,
        rows: Tensor | None,
        width: Tensor | None,
        curvature: bool,
    ) -> Sums:
        """What a pass adds up, from responses on all pairs."""
        dtype, problems = self.problem.target.dtype, len(albedos)
        narrow = albedos.to(dtype)
        found: list[Sums] = []
        for part, pairs in self.chunks(problems):
            if pairs.shape[0] > 1 and rows is not None:
                pairs = pairs.select(rows)
            responses = basis.stacked(pairs, values, dtype, problems)
            target, weight = self.encoded.part(part, rows)
            code, rate = channels.encode_with_derivative(self.loss, basis.predict(narrow, responses), pairs)
            penalty, slope, curve = self.loss.penalty_with_derivatives(code - target, width)
            if weight is not None:
                penalty, slope, curve = penalty * weight, slope * weight, curve * weight
            used, grams = responses[:, : basis.used], None
            if curvature:
                curve = (curve * rate.square()).expand(problems, -1, used.shape[2])
                curved = (curve[:, :, None] * used[:, None]).flatten(1, 2)
                grams = torch.bmm(curved, used.mT).double().unflatten(1, (-1, basis.used))
            slopes = torch.bmm(slope * rate, used.mT).double()
            found.append(Sums(penalty.sum((1, 2)).double(), slopes, grams, self._binned(part, rows, responses)))
        if not found:  # no pair at all
            nothing = albedos.new_zeros(problems, basis.channels, basis.used, basis.used, dtype=torch.float64)
            return Sums(nothing[:, 0, 0, 0], nothing[..., 0], nothing if curvature else None)
        total = found[0]
        for one in found[1:]:
            total = total.plus(one)
        return total

    def _binned(self, samples: slice, rows: Tensor | None, responses: Tensor) -> Tensor | None:
        """What else is wanted of the responses `(m, Q, n)` on some pairs."""
        return None

    def _with_bins(self, sums: Sums, responses: Tensor, factors: Factors, rows: Tensor | None) -> Sums:
        """The same, where responses are sums of factors, `(m, Q, G J)`."""
        return sums

    def _total(
        self, sums: Sums, jacobian: Tensor, albedos: Tensor, rows: Tensor | None, width: Tensor | None
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Value, gradient and matrix (empty, if there is no curvature), but for the norm."""
        return sums.chained(jacobian)
