"""The directions at which losses are scored."""

import math

import torch

from torchbrdf.errors import UsageError
from torchbrdf.pairs import Pairs, check_max_theta


def uniform_pairs(count: int = 6000, max_theta: float = 80.0, seed: int = 0) -> Pairs:
    """Random pairs of directions, uniform in (theta_i, theta_o, phi), at which losses are scored.

    Both directions are at most `max_theta` degrees from the normal; phi, the azimuth between them, is uniform on the
    circle. All count alike: no solid angle, no cosine. As phi_d is folded into [0, pi), light and viewer of some are
    exchanged, which leaves the draw what it is.

    Args:
        count: Of pairs, at least 1.
        max_theta: Degrees, above 0 and at most 90.
        seed: Of the random numbers.

    Returns:
        Pairs `(count,)`, float64.

    Raises:
        UsageError: A number is out of range.

    Example:
        >>> pairs = uniform_pairs(100, max_theta=60)
        >>> len(pairs), bool((pairs.cos_i > 0.4999).all())
        (100, True)
    """
    if count < 1:
        raise UsageError(f"uniform_pairs: count: expected at least 1, found {count}")
    check_max_theta(max_theta)
    drawn = torch.rand(3, count, dtype=torch.float64, generator=torch.Generator("cpu").manual_seed(seed), device="cpu")
    theta_i, theta_o = drawn[:2] * math.radians(max_theta)
    phi = drawn[2] * (2 * math.pi)
    wi = torch.stack([theta_i.sin(), torch.zeros_like(phi), theta_i.cos()], -1)
    wo = torch.stack([theta_o.sin() * phi.cos(), theta_o.sin() * phi.sin(), theta_o.cos()], -1)
    pairs = Pairs.from_directions(wi, wo)
    return Pairs.from_half_diff(pairs.theta_h, pairs.theta_d, pairs.phi_d)
