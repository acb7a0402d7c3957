"""Schlick's approximation of Fresnel's reflectance."""

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


def _fifth(cos_d: Tensor) -> Tensor:
    rest = 1 - cos_d
    return rest.square().square() * rest


def _blend(f0: Tensor, fifth: Tensor) -> Tensor:
    return f0 + (1 - f0) * fifth
