"""The objective of a quadratic loss from sufficient statistics: exact, at the cost of a few hundred pairs.

With S' S = sum w B B' and S' z = sum w t B, the sum of w (f - t)^2 over a group of pairs is |S H - z|^2 and what no
parameter changes: least squares in G J numbers a channel. The H follow from the terms at probes, see `pair_factors`.
"""

from functools import cached_property
from typing import Self

import torch
from torch import Tensor

from torchbrdf.fitting.basis import Basis
from torchbrdf.fitting.objective.base import GaussNewtonObjective
from torchbrdf.fitting.objective.factored import Sums
from torchbrdf.fitting.pair_factors import RANK, coefficients, inverse_of, rows_times
from torchbrdf.fitting.parameters import Parametrization
from torchbrdf.fitting.sufficient_statistics import SufficientStatistics
from torchbrdf.lobes import Lobe
from torchbrdf.lobes.parameter_dict import ParameterDict, get_parameters
from torchbrdf.losses import Loss, Problem


class QuadraticObjective(GaussNewtonObjective):
    """The mean of weighted squares over all pairs."""

    def __init__(self, statistics: SufficientStatistics, loss: Loss) -> None:
        self.statistics = statistics
        super().__init__(Problem(statistics.probes, self._reduced[1].mT), loss)

    @cached_property
    def _reduced(self) -> tuple[Tensor, Tensor]:
        """What makes S H of H, `(M, G, J, J)`, and z, `(M, C, G J)`."""
        own = self.statistics
        # In units in which all factors are of a size, as some are 1e6 times others towards the horizon.
        size = own.at_probes.abs().amax(2, keepdim=True).clamp_min(torch.finfo(own.gram.dtype).tiny)
        square, axes = torch.linalg.eigh(own.gram / size / size.mT)
        kept = square > RANK * square[..., -1:]
        root = torch.where(kept, square, 0).sqrt()
        rotated = axes.mT @ (own.right / size)
        target = torch.where(kept, 1 / torch.where(kept, root, 1), 0)[..., None] * rotated
        return root[..., None] * axes.mT * size.mT, target.permute(0, 3, 1, 2).flatten(2)

    @cached_property
    def rest(self) -> Tensor:
        """The sum that no parameter changes, `(M,)`."""
        return (self.statistics.zero - self.target.square().sum((1, 2))).clamp_min(0)

    @cached_property
    def zero_prediction_error(self) -> Tensor:
        """The mean square of what is compared."""
        found = self.statistics.zero / self.statistics.total
        return torch.where(found > 0, found, 1)

    @property
    def target_scale(self) -> Tensor:
        """Its root."""
        return self.zero_prediction_error.sqrt()

    @property
    def target(self) -> Tensor:
        """z."""
        return self._reduced[1]

    def observe(self, responses: Tensor) -> Tensor:
        """S H of functions at the probes, `(M, 1, K, G J)`."""
        own, root = self.statistics, self._reduced[0]
        at_probes = responses.unflatten(1, (len(own.at_probes), -1)).transpose(0, 1)
        return (at_probes @ inverse_of(own.at_probes) @ root.mT).transpose(1, 2).flatten(2)[:, None]

    def curvature_at(self, prediction: Tensor) -> Tensor:
        """2."""
        return prediction.new_full((1, 1, 1), 2)

    def describe_size(self) -> str:
        """What a solver sees."""
        return f"sums of all samples at {self.statistics.gram.shape[1]} half angles"

    def select(self, material: int) -> Self:
        """The same for one material."""
        return type(self)(self.statistics.select([material]), self.loss)

    def subsample(self, samples: int, seed: int) -> Self:
        """Itself: no subset costs less."""
        return self

    def errors(self, model: Lobe) -> Tensor:
        """The errors of a batched model on all pairs, `(M,)`, float64, on the CPU."""
        basis, every = Basis(Parametrization(model, [])), self.material_indices
        value, *_ = self.evaluate(basis, get_parameters(model), every, torch.ones_like(self.zero_prediction_error))
        return self.loss.finalize(value).cpu()

    def evaluate(
        self,
        basis: Basis,
        values: ParameterDict,
        materials: Tensor,
        scale: Tensor,
        width: Tensor | None = None,
        curvature: bool = False,
    ) -> tuple[Tensor, Tensor, Tensor]:
        """From the terms at the probes."""
        rows = None if self.is_every_material(materials) else materials
        own, (root, target) = self.statistics, self._reduced
        albedos = basis.albedos(values, target.dtype)
        responses = coefficients(basis, own.own, values, len(materials))
        seen = rows_times(responses, _of(root, rows).mT[:, None]).flatten(2)
        used, residual = seen[:, : basis.used], basis.predict(albedos, seen) - _of(target, rows)
        value = residual.square().sum((1, 2)) + _of(self.rest, rows)
        gram = (2 * used @ used.mT)[:, None] if curvature else None
        found = Sums(value, 2 * residual @ used.mT, gram).chained(basis.jacobian(values, albedos))
        norm = _of(own.total, rows) * scale
        matrix = found[2] / norm[:, None, None] if curvature else found[2]
        return found[0] / norm, found[1] / norm[:, None], matrix


def _of(values: Tensor, rows: Tensor | None) -> Tensor:
    """What belongs to these materials."""
    return values if rows is None or len(values) == 1 else values[rows]
