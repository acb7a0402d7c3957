"""The terms and colours that materials share."""

from torch import Tensor

from torchbrdf.lobes.fresnel import schlick_weight
from torchbrdf.pairs import Pairs


def f82_weight(pairs: Pairs) -> Tensor:
    """cos_d (1 - cos_d)^6 over its largest value, that at cos_d = 1/7, `(..., N)`."""

    def make() -> Tensor:
        cosine = pairs.cos_d
        return schlick_weight(pairs) * (1 - cosine) * cosine * (7 * (7 / 6) ** 6)

    return pairs.cached(f82_weight, make)


def f82_colours(f0: Tensor, tint: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """What 1, `schlick_weight` and `f82_weight` are multiplied by in F.

    Its value where cos_d = 1/7 is tint times Schlick's.
    """
    return f0, 1 - f0, (tint - 1) * (f0 + (1 - f0) * (6 / 7) ** 5)
