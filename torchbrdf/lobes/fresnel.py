"""Fresnel's reflectance: Schlick's approximation, and that of metals."""

import torch
from torch import Tensor

from torchbrdf.pairs import Pairs


def schlick(f0: Tensor, cos_d: Tensor) -> Tensor:
    """Schlick's approximation of Fresnel's reflectance: F0 + (1 - F0) (1 - cos_d)^5 (the paper's eq. 3).

    Args:
        f0: reflectance at normal incidence; broadcasts against cos_d.
        cos_d: cosine of the angle of incidence.

    Returns:
        The reflectance.

    Source: C. Schlick, An Inexpensive BRDF Model for Physically-based Rendering, 1994, doi:10.1111/1467-8659.1330233.

    Example:
        >>> import torch
        >>> from torchbrdf.lobes import schlick
        >>> schlick(torch.tensor(0.04), torch.tensor([1.0, 0.5, 0.0]))
        tensor([0.0400, 0.0700, 1.0000])
    """
    return _blend(f0, _fifth(cos_d))


def fresnel(f0: Tensor, pairs: Pairs) -> Tensor:
    """`schlick` on pairs, which keep the fifth power."""
    return _blend(f0, schlick_weight(pairs))


def schlick_weight(pairs: Pairs) -> Tensor:
    """(1 - cos_d)^5, `(..., N)`."""
    return pairs.cached(schlick_weight, lambda: _fifth(pairs.cos_d))


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


def _fifth(cos_d: Tensor) -> Tensor:
    rest = 1 - cos_d
    return rest.square().square() * rest


def _blend(f0: Tensor, fifth: Tensor) -> Tensor:
    return f0 + (1 - f0) * fifth


def conductor(eta: Tensor, k: Tensor, cos_d: Tensor) -> Tensor:
    """Fresnel's reflectance of unpolarized light for a metal of the index of refraction eta + i k.

    Args:
        eta: real part, above 0; broadcasts against cos_d.
        k: imaginary part, from 0 on.
        cos_d: cosine of the angle of incidence.

    Returns:
        The reflectance, in [0, 1].

    Source: M. Born and E. Wolf, Principles of Optics, 1999, section 14.2.

    Example:
        >>> import torch
        >>> from torchbrdf.lobes import conductor
        >>> conductor(torch.tensor(0.2), torch.tensor(3.0), torch.tensor([1.0, 0.5, 0.0]))
        tensor([0.9234, 0.9184, 1.0000])
    """
    square = cos_d.square()
    sine = 1 - square
    real, imaginary = eta.square() - k.square() - sine, 2 * eta * k
    # a^2 + b^2 and a^2 of the refracted cosine times the index, a + i b; a by way of b where real is below 0.
    length = (real.square() + imaginary.square()).sqrt()
    larger = (0.5 * (length + real.abs())).sqrt()
    a = torch.where(real > 0, larger, 0.5 * imaginary / larger)
    cross = 2 * a * cos_d
    across = (length + square - cross) / (length + square + cross)
    along = square * length + sine.square()
    along = (along - cross * sine) / (along + cross * sine)
    return 0.5 * across * (1 + along)
