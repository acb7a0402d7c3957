"""Sums of lobes."""

from torch import Tensor, nn

from torchbrdf.errors import UsageError
from torchbrdf.lobes.base import Lobe
from torchbrdf.pairs import Pairs


class Sum(Lobe):
    """The sum of its lobes: `Sum(Lambert(), Ward(), Ward())` is the paper's eq. 11 with Ward's model.

    Args:
        lobes: what to add; the lobes of sums among them are taken out of these.

    Raises:
        UsageError: there is none.

    Example:
        >>> from torchbrdf.lobes import Lambert, Sum, Ward
        >>> model = Sum(Lambert(albedo=0.2), Ward(roughness=0.1))
        >>> [type(lobe).__name__ for lobe in model.components()]
        ['Lambert', 'Ward']
    """

    def __init__(self, *lobes: Lobe) -> None:
        super().__init__()
        if not lobes:
            raise UsageError("Sum: expected at least one lobe, found none")
        self.lobes = nn.ModuleList(component for lobe in lobes for component in lobe.components())

    def components(self) -> list[Lobe]:
        """The lobes that are added, without nesting."""
        return list(self.lobes)  # type: ignore[arg-type]

    def forward(self, pairs: Pairs) -> Tensor:
        """The sum of the lobes' values on pairs, `(..., N, 3)`."""
        first, *rest = self.lobes
        total: Tensor = first(pairs)
        for lobe in rest:
            total = total + lobe(pairs)
        return total
