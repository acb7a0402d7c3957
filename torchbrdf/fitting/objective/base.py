"""What every objective of a fit offers."""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar, Self

import torch
from torch import Tensor

from torchbrdf.fitting.basis import Basis
from torchbrdf.fitting.parameters import Parametrization
from torchbrdf.fitting.sampling import stratified
from torchbrdf.lobes.parameter_dict import ParameterDict, take_materials
from torchbrdf.losses import Loss, Problem
from torchbrdf.solvers import FirstOrder


class FitObjective(ABC):
    """A loss on a problem of M materials, as something to minimise over the parameters of a model.

    It is differentiable wherever a fit goes, and `loss.finalize` of it is the error. Solvers see it in units of
    `zero_prediction_error`. Inside of it channels come before pairs.
    """

    ftol: ClassVar[float] = 1e-8
    """How small a share of the value a solver can still see."""
    fmin: ClassVar[float] = 1e-12
    """A value, in units of `zero_prediction_error`, that is as good as 0: single precision sees no smaller one."""

    def __init__(self, problem: Problem, loss: Loss) -> None:
        self.problem, self.loss = problem, loss

    def __len__(self) -> int:
        return len(self.problem.target)

    @staticmethod
    def applies(loss: Loss) -> bool:
        """Whether a loss has the form that this kind of objective needs."""
        return True

    @property
    @abstractmethod
    def zero_prediction_error(self) -> Tensor:
        """The value of a prediction that is 0 everywhere, `(M,)`, float64; 1 where that is 0, as it is a unit."""

    @abstractmethod
    def bind(
        self, parametrization: Parametrization, values: ParameterDict, materials: Tensor | None = None
    ) -> FirstOrder:
        """R problems for a solver, each a material with held parameters of its own.

        Values are in units of `zero_prediction_error`. materials: `(R,)`, which each is of; None: all, in their order.
        """

    @property
    def scored(self) -> Problem:
        """The problem that the loss gives errors of."""
        return self.problem

    @cached_property
    def material_indices(self) -> Tensor:
        """The materials, `(M,)`."""
        return torch.arange(len(self), dtype=torch.int64, device=self.problem.target.device)

    def is_every_material(self, materials: Tensor) -> bool:
        """Whether these are all, in their order, so that nothing need be picked."""
        return len(materials) == len(self) and torch.equal(materials, self.material_indices)

    def describe_size(self) -> str:
        """How much a solver sees, in words."""
        return f"{len(self.problem.pairs)} samples"

    def select(self, material: int) -> Self:
        """The same for one material."""
        return type(self)(self.problem.select(self.material_indices[material : material + 1]), self.loss)

    def subsample(self, samples: int, seed: int) -> Self:
        """The same on a stratified random subset of so many pairs; itself, if there are no more."""
        index = stratified(len(self.problem.pairs), samples, seed)
        if index is None:
            return self
        if (samples, seed) not in self._parts:
            part = self.problem.select(samples=index.to(self.problem.target.device))
            self._parts[samples, seed] = type(self)(part, self.loss)
        return self._parts[samples, seed]

    @cached_property
    def _parts(self) -> dict[tuple[int, int], Self]:
        """Subsets that were made, by their sizes and seeds: the same for all models."""
        return {}


class GaussNewtonObjective(FitObjective):
    """An objective with curvature, of models that are sums of colours times scalar functions."""

    starts_are_cheap: ClassVar[bool] = True
    """Whether a few starts more cost little: there are coarse ones of it that cost little."""

    @property
    @abstractmethod
    def target_scale(self) -> Tensor:
        """The unit of `Loss.smoothing_widths`, `(M,)`, float64."""

    @property
    @abstractmethod
    def target(self) -> Tensor:
        """The values, or what is observed of them, that a fit aims at, `(M, C, P)`, float64."""

    @abstractmethod
    def observe(self, responses: Tensor) -> Tensor:
        """Scalar functions of the pairs `(K, N)` as each channel sees them, `(C|1, K, P)`, float64."""

    @abstractmethod
    def curvature_at(self, prediction: Tensor) -> Tensor:
        """The curvature of the loss by each value, or observation, of `prediction`, `(M, C, P)`; `(M|1, C|1, P)`."""

    @abstractmethod
    def evaluate(
        self,
        basis: Basis,
        values: ParameterDict,
        materials: Tensor,
        scale: Tensor,
        width: Tensor | None = None,
        curvature: bool = False,
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Value `(m,)`, gradient `(m, P)` and Gauss-Newton matrix `(m, P, P)`, float64, of some problems.

        values: all parameters, of each problem; materials: of which material each is, `(m,)`; scale: the value that
        counts as 1, `(m,)`; width: over which a cusp is rounded, `(m,)`; curvature: whether the matrix is wanted, which
        is empty if not.
        """

    def bind(
        self,
        parametrization: Parametrization,
        values: ParameterDict,
        materials: Tensor | None = None,
        width: Tensor | None = None,
    ) -> "BoundObjective":
        """R problems for a solver, with curvature; width: over which a cusp is rounded there, `(R,)`."""
        materials = self.material_indices if materials is None else materials
        scale = self.zero_prediction_error[materials]
        return BoundObjective(self, parametrization, values, materials, scale, width)

    def coarse(self, samples: int) -> "GaussNewtonObjective":
        """The same on so little that many starts can be compared: about so many samples, or a share of a picture."""
        return self.subsample(samples, 0)

    def surrogate(self) -> "GaussNewtonObjective":
        """One with curvature that leads to nearly the same fits; itself, if it has curvature."""
        return self


@dataclass
class BoundObjective:
    """R problems under a Gauss-Newton objective, as `torchbrdf.solvers` sees them.

    scale: the value that counts as 1, `(R,)`; width: over which a cusp is rounded, `(R,)`.
    """

    objective: GaussNewtonObjective
    parametrization: Parametrization
    values: ParameterDict
    materials: Tensor
    scale: Tensor
    width: Tensor | None

    def __post_init__(self) -> None:
        self._basis = Basis(self.parametrization)
        moved = {name for one in self.parametrization.free for name in one.names}
        self._held = {name: value for name, value in self.values.items() if name not in moved}

    def value_and_gradient(self, x: Tensor, rows: Tensor) -> tuple[Tensor, Tensor]:
        """Value and gradient of the loss itself, not rounded."""
        return self._evaluate(x, rows, None, False)[:2]

    def quadratic_model(self, x: Tensor, rows: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Value, gradient and matrix, with cusps rounded over the width."""
        return self._evaluate(x, rows, None if self.width is None else self.width[rows], True)

    def _evaluate(
        self, x: Tensor, rows: Tensor, width: Tensor | None, curvature: bool
    ) -> tuple[Tensor, Tensor, Tensor]:
        here = take_materials(self._held, rows) | self.parametrization.decode(x, self.objective.problem.target.dtype)
        return self.objective.evaluate(self._basis, here, self.materials[rows], self.scale[rows], width, curvature)
