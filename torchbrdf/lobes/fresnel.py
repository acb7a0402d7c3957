"""Schlick's approximation of Fresnel's reflectance."""

from torch import Tensor


def schlick(f0: Tensor, cos_d: Tensor) -> Tensor:
    """F0 + (1 - F0) (1 - cos_d)^5 (the paper's eq. 3).

    f0: reflectance at normal incidence, broadcasts against cos_d. Source: C. Schlick, An Inexpensive BRDF Model
    for Physically-based Rendering, 1994, doi:10.1111/1467-8659.1330233.
    """
    grazing = 1 - cos_d
    fifth = grazing.square().square() * grazing
    return f0 + (1 - f0) * fifth
