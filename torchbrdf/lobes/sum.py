"""Sums of lobes."""

from collections.abc import Sequence

from torch import Tensor, nn

from torchbrdf.errors import UsageError, shown
from torchbrdf.lobes.base import Lobe
from torchbrdf.pairs import Pairs


class Sum(Lobe):
    """The sum of its lobes: `Sum(Lambert(), Ward(), Ward())` is the paper's eq. 11 with Ward's model.

    Args:
        lobes: what to add; the lobes of sums among them are taken out of these.
        shared: names of parameters that a fit keeps the same for all specular lobes that have them, such as `f0`.

    Raises:
        UsageError: there is none, they have different numbers of channels, or a name to share is not of two or more
            lobes that allow the same values.

    Example:
        >>> from torchbrdf.lobes import Lambert, Sum, Ward
        >>> model = Sum(Lambert(albedo=0.2), Ward(roughness=0.1))
        >>> [type(lobe).__name__ for lobe in model.components()]
        ['Lambert', 'Ward']
    """

    def __init__(self, *lobes: Lobe, shared: Sequence[str] = ()) -> None:
        super().__init__()
        if not lobes:
            raise UsageError("Sum: expected at least one lobe, found none")
        self.lobes = nn.ModuleList(component for lobe in lobes for component in lobe.components())
        self.shared = tuple(shared)
        counts = {lobe.channels for lobe in self.components()}
        if len(counts) > 1:
            raise UsageError(f"Sum: expected lobes with as many channels each, found {' and '.join(map(str, counts))}")
        check_shared([type(lobe) for lobe in self.components()], self.shared)

    def components(self) -> list[Lobe]:
        """The lobes that are added, without nesting."""
        return list(self.lobes)  # type: ignore[arg-type]

    @property
    def is_anisotropic(self) -> bool:  # type: ignore[override]
        """Whether one of its lobes is."""
        return any(lobe.is_anisotropic for lobe in self.components())

    def forward(self, pairs: Pairs) -> Tensor:
        """The sum of the lobes' values on pairs, `(..., N, C)`."""
        first, *rest = self.lobes
        total: Tensor = first(pairs)
        for lobe in rest:
            total = total + lobe(pairs)
        return total


def check_shared(kinds: Sequence[type[Lobe]], shared: Sequence[str]) -> None:
    """Refuse names of parameters that lobes of these kinds cannot share.

    Raises:
        UsageError: fewer than two specular lobes have one, or they declare it so that no value suits all.
    """
    specular = [kind for kind in kinds if not kind.is_diffuse]
    for name in shared:
        specs = [kind.parameter_specs[name] for kind in specular if name in kind.parameter_specs]
        if len(specs) < 2:
            known = ", ".join(dict.fromkeys(name for kind in specular for name in kind.parameter_specs))
            raise UsageError(f"shared: expected a parameter of two lobes or more (of {known}), found {shown(name)}")
        lower, upper = max(spec.lower for spec in specs), min(spec.upper for spec in specs)
        if lower > upper or len({(spec.shape, spec.log) for spec in specs}) > 1:
            raise UsageError(f"shared: expected lobes that declare {name} alike, found others")
    if len({*shared}) < len(shared):
        raise UsageError(f"shared: expected each name once, found {', '.join(shared)}")
