"""Fresnel's reflectance: Schlick's approximation, and that of metals and of dielectrics."""

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


def dielectric(ior: Tensor, cos_d: Tensor) -> Tensor:
    """Fresnel's reflectance of unpolarized light for a real index of refraction n.

    1/2 a^2 (1 + b^2), with g^2 = n^2 - 1 + cos_d^2, a = (g - cos_d) / (g + cos_d) and
    b = (cos_d (g + cos_d) - 1) / (cos_d (g - cos_d) + 1).

    Args:
        ior: n, from 1 on; broadcasts against cos_d.
        cos_d: cosine of the angle of incidence.

    Returns:
        The reflectance, in [0, 1].

    Source: R. Cook and K. Torrance, A Reflectance Model for Computer Graphics, 1982, doi:10.1145/357290.357293.

    Example:
        >>> import torch
        >>> from torchbrdf.lobes import dielectric
        >>> dielectric(torch.tensor(1.5), torch.tensor([1.0, 0.5, 0.0]))
        tensor([0.0400, 0.0892, 1.0000])
    """
    _, a, b = _fresnel_terms(ior, cos_d)
    return 0.5 * a.square() * (1 + b.square())


def dielectric_derivative(ior: Tensor, cos_d: Tensor) -> Tensor:
    """The derivative of `dielectric` by n."""
    g, a, b = _fresnel_terms(ior, cos_d)
    # Derivatives by g; that of g by the index is n / g.
    slope_a = 2 * cos_d / (g + cos_d).square()
    slope_b = 2 * cos_d * (1 - cos_d.square()) / (cos_d * (g - cos_d) + 1).square()
    slope = a * (1 + b.square()) * slope_a + a.square() * b * slope_b
    return slope * (ior / g)


def _fresnel_terms(ior: Tensor, cos_d: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """g, a and b of `dielectric`; g - cos_d is (n^2 - 1) / (g + cos_d), which cancels nothing."""
    excess = (ior - 1) * (ior + 1)
    g = (excess + cos_d.square()).clamp_min(1e-12).sqrt()
    total = g + cos_d
    less = excess / total
    return g, less / total, (cos_d * total - 1) / (cos_d * less + 1)
