"""What a loss of groups adds to the squared error of many fits: residuals that are linear in averages over pairs."""

import torch
from torch import Tensor

from torchbrdf.losses import GroupedLoss, Grouping, Problem


class Groups:
    """The groups of a problem under a loss.

    weight: how much the square of each difference counts, `(M|1, N, 3)`; shares: `(M|1, N, G)`; given: the weights of
    the problem, `(M|1, 1, N)`, if it has any; held: `(M|1, 1, G)`.
    """

    def __init__(self, problem: Problem, loss: GroupedLoss) -> None:
        own: Grouping = loss.grouping(problem.pairs, problem.weight, problem.target)
        self.shares, self.held = own.shares, own.held
        self.given = None if problem.weight is None else problem.weight.transpose(1, 2)
        self.weight = own.profile if problem.weight is None else own.profile * problem.weight
        self.root = loss.root(3).to(self.held)


class Averages:
    """The averages of some problems, `(m, 3, G)`, and their derivatives by columns, summed over parts of the pairs."""

    def __init__(self, groups: Groups, materials: Tensor | None) -> None:
        self.groups, self.materials = groups, materials
        self.means: Tensor | float = 0.0
        self.slopes: Tensor | float = 0.0

    def add(self, samples: slice, difference: Tensor, rate: Tensor, basis: Tensor) -> None:
        """Some pairs: differences and their rates `(m, 3, n)`, columns `(m, q, n)`."""
        shares = self._own(self.groups.shares[:, samples])
        if self.groups.given is not None:
            given = self._own(self.groups.given[..., samples])
            difference, rate = difference * given, rate * given
        moved = (rate[:, :, None] * basis[:, None]).flatten(1, 2)
        self.means = self.means + (difference @ shares).double()
        self.slopes = self.slopes + (moved @ shares).double()

    def residuals(self, jacobian: Tensor) -> tuple[Tensor, Tensor]:
        """The residuals `(m, K)` and their derivatives `(m, P, K)`; jacobian: of `Columns`, `(m, 3, q, P)`."""
        held, root = self._own(self.groups.held), self.groups.root
        assert isinstance(self.means, Tensor) and isinstance(self.slopes, Tensor)
        slopes = (self.slopes / held).unflatten(1, (3, -1))
        by_variable = torch.einsum("rcqg,rcqp->rpcg", slopes, jacobian)
        return (self.means / held).flatten(1) @ root, by_variable.flatten(2) @ root

    def _own(self, values: Tensor) -> Tensor:
        """What belongs to these materials."""
        return values if self.materials is None or len(values) == 1 else values[self.materials]
