"""The objective of a loss of observations, such as pictures.

What is observed of f_c = sum_k color_kc s_k is the same sum of what is observed of the responses: one sparse product a
step, and then only small arrays, one number for each observation.
"""

from functools import cached_property

import torch
from torch import Tensor

from torchbrdf.fitting.basis import Basis
from torchbrdf.fitting.objective.base import GaussNewtonObjective
from torchbrdf.fitting.sampling import Chunks
from torchbrdf.lobes.parameter_dict import ParameterDict
from torchbrdf.losses import ImageLoss, Problem


class ImageObjective(GaussNewtonObjective):
    """What an `ImageLoss` compares of P observations."""

    ftol = 1e-6
    fmin = 1e-10
    starts_are_cheap = False
    loss: ImageLoss

    def __init__(self, problem: Problem, loss: ImageLoss) -> None:
        super().__init__(problem, loss)

    @cached_property
    def observed_target(self) -> Tensor:
        """What is observed of the targets, `(M, P, 3)`, as the loss has it."""
        with torch.no_grad():
            return self.loss.observe(self.problem.target)

    @cached_property
    def chunks(self) -> Chunks:
        """The pairs in parts."""
        return Chunks(self.problem.pairs)

    @cached_property
    def zero_prediction_error(self) -> Tensor:
        """What the loss says of a black picture."""
        with torch.no_grad():
            found = self.loss.compare(torch.zeros_like(self.observed_target), self.observed_target).double()
        return torch.where(found > 0, found, 1)

    @property
    def target_scale(self) -> Tensor:
        """The same, as a unit for the rounding of cusps."""
        return self.zero_prediction_error

    @property
    def target(self) -> Tensor:
        """What is observed of the targets."""
        return self.observed_target.mT.double()

    def observe(self, responses: Tensor) -> Tensor:
        """What each channel of the light makes of scalar functions."""
        return self.loss.observe_basis(responses.to(self.problem.target.dtype)).transpose(0, 1).double()

    def curvature_at(self, prediction: Tensor) -> Tensor:
        """The diagonal of the majorizer's."""
        dtype, share = self.problem.target.dtype, self.loss.smoothing_widths[0]
        width = None if share is None else share * self.target_scale
        *_, curve = self.loss.quadratic_majorizer(prediction.mT.to(dtype), self.observed_target, width)
        return torch.diagonal(curve, dim1=-2, dim2=-1).mT.double()

    def describe_size(self) -> str:
        """Observations, and the loss, which can be a surrogate."""
        return f"{self.observed_target.shape[1]} observations, {self.loss.registered_name}"

    def coarse(self, samples: int) -> "ImageObjective":
        """On a share of the observations."""
        loss, problem = self.loss.subsample(self.problem)
        return ImageObjective(problem, loss)

    def surrogate(self) -> "ImageObjective":
        """Under a loss that has a majorizer, where its own has none."""
        return self if self.loss.has_majorizer else ImageObjective(self.problem, self.loss.surrogate())

    def evaluate(
        self,
        basis: Basis,
        values: ParameterDict,
        materials: Tensor,
        scale: Tensor,
        width: Tensor | None = None,
        curvature: bool = False,
    ) -> tuple[Tensor, Tensor, Tensor]:
        """From what is observed of the responses."""
        dtype = self.problem.target.dtype
        albedos = basis.albedos(values, dtype)
        responses = self._observed_responses(basis, values, len(materials))
        observed = torch.einsum("rck,rkcp->rpc", albedos, responses[:, len(basis.slopes) :])
        target = self.observed_target[materials]
        if curvature:
            value, slope, curve = self.loss.quadratic_majorizer(observed, target, width)
        else:
            value, slope = self._compare_with_gradient(observed, target)
        jacobian = basis.jacobian(values, albedos.double()).to(dtype)
        picture_jacobian = torch.einsum("rqcp,rcqt->rtpc", responses[:, : basis.used], jacobian).flatten(2)
        gradient = (picture_jacobian @ slope.flatten(1)[..., None])[..., 0].double() / scale[:, None]
        if not curvature:
            return value / scale, gradient, gradient.new_empty(0)
        curved_jacobian = torch.einsum("rpcd,rtpd->rtpc", curve, picture_jacobian.unflatten(2, (-1, 3))).flatten(2)
        matrix = (picture_jacobian @ curved_jacobian.mT).double()
        return value / scale, gradient, (matrix + matrix.mT) / (2 * scale[:, None, None])

    def _observed_responses(self, basis: Basis, values: ParameterDict, problems: int) -> Tensor:
        """What each channel observes of the responses, `(m, Q, 3, P)`."""
        pairs, dtype = self.problem.pairs, self.problem.target.dtype
        count = len(basis.slopes) + basis.terms
        responses = torch.empty(problems, count, len(pairs), dtype=dtype, device=pairs.device)
        for part, own in self.chunks(problems):
            for k, one in enumerate(basis.responses(own, values, dtype)):
                responses[:, k, part] = one
        return self.loss.observe_basis(responses.flatten(0, 1)).unflatten(0, (problems, count))

    def _compare_with_gradient(self, observed: Tensor, target: Tensor) -> tuple[Tensor, Tensor]:
        with torch.enable_grad():
            point = observed.detach().requires_grad_()
            value = self.loss.compare(point, target)
            (slope,) = torch.autograd.grad(value.sum(), point)
        return value.detach().double(), slope
