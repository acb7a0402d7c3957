"""The quantities of pairs of directions, and how they follow from each other."""

from collections.abc import Callable, Mapping

import torch
from torch import Tensor

from torchbrdf.errors import ShapeError, UsageError
from torchbrdf.half_difference import directions, half_vector, nonzero, norm, phi_d, phi_h, slopes, turned
from torchbrdf.roots import safe_ratio, safe_sqrt

ORIENTED = ("wi", "wo", "phi_h", "slope_x", "slope_y")
"""Those that say how a pair lies to the tangent."""
QUANTITIES = (
    *("wi", "wo", "cos_i", "cos_o", "cos_h", "cos_d", "tan2_h", "theta_h", "theta_d", "phi_d"),
    *("phi_h", "slope_x", "slope_y", "above_horizon"),
)
"""What a `Pairs` can hold and be asked for."""
_OF_HALF = ("cos_h", "tan2_h", "theta_h")


def of_directions(wi: Tensor, wo: Tensor) -> dict[str, Tensor]:
    """What is known at once of unit vectors `(..., N, 3)` of one shape and dtype."""
    half = half_vector(wi, wo)
    square = half.square()
    horizontal = square[..., 0] + square[..., 1]
    length = safe_sqrt(horizontal + square[..., 2])
    return {
        "wi": wi,
        "wo": wo,
        "cos_i": wi[..., 2],
        "cos_o": wo[..., 2],
        "cos_h": half[..., 2] / nonzero(length),
        "cos_d": length / 2,
        "tan2_h": safe_ratio(horizontal, square[..., 2]),
    }


def of_half_diff(theta_h: Tensor, theta_d: Tensor, phi_d: Tensor, phi_h: Tensor | None = None) -> dict[str, Tensor]:
    """What is known at once of half and difference angles of one dtype that broadcast."""
    sin_h, cos_h, sin_d, cos_d = theta_h.sin(), theta_h.cos(), theta_d.sin(), theta_d.cos()
    even, odd = cos_h * cos_d, sin_h * sin_d * phi_d.cos()
    return {
        "theta_h": theta_h,
        "theta_d": theta_d,
        "phi_d": phi_d,
        **({} if phi_h is None else {"phi_h": phi_h}),
        "cos_i": even - odd,
        "cos_o": even + odd,
        "cos_h": cos_h,
        "cos_d": cos_d,
        "tan2_h": (sin_h / torch.where(cos_h == 0, torch.finfo(theta_h.dtype).tiny, cos_h)).square(),
    }


def is_oriented(known: Mapping[str, Tensor]) -> bool:
    """Whether it is known how pairs lie to the tangent, by what was given: that comes before what was derived of it.

    Directions that were derived of half and difference angles, or that stand behind these, lie anyhow.
    """
    if "phi_h" in known or ("slope_x" in known and "slope_y" in known):
        return True
    return next((name for name in known if name in ("wi", *_OF_HALF)), "") == "wi" and "wo" in known


def derived(name: str, known: Mapping[str, Tensor], get: Callable[[str], Tensor]) -> Tensor:
    """A quantity that is not known, from those that are; `get` gives any of them, and derives it if need be.

    Raises:
        ShapeError: it does not follow from what is known.
    """
    if name == "above_horizon":
        return (get("cos_i") > 0) & (get("cos_o") > 0)
    if name == "tan2_h" and "cos_h" in known:
        square = get("cos_h").square()
        return safe_ratio((1 - square).clamp_min(0), square)
    if name == "theta_h" and ("tan2_h" in known or "cos_h" in known):
        tangent = safe_sqrt(get("tan2_h"))
        return torch.atan2(tangent, torch.ones_like(tangent))
    if name == "theta_d" and "wi" in known:
        return torch.atan2(norm(get("wi") - get("wo")), norm(half_vector(get("wi"), get("wo"))))
    if name == "theta_d" and "cos_d" in known:
        return torch.atan2(safe_sqrt((1 - get("cos_d").square()).clamp_min(0)), get("cos_d"))
    if name == "phi_d" and "wi" in known:
        return phi_d(get("wi"), get("wo"))
    if name in ("slope_x", "slope_y", "phi_h") and is_oriented(known):
        return _about_the_normal(name, known, get)
    if name in ("wi", "wo") and "phi_d" in known:
        wi, wo = directions(get("theta_h"), get("theta_d"), get("phi_d"))
        if "cos_i" in known:
            # phi_d is folded into half a turn: which of both is the light's, the cosine says.
            exchanged = (wo[..., 2] - known["cos_i"]).abs() < (wi[..., 2] - known["cos_i"]).abs()
            wi, wo = torch.where(exchanged[..., None], wo, wi), torch.where(exchanged[..., None], wi, wo)
        found = wi if name == "wi" else wo
        return turned(found, get("phi_h")) if is_oriented(known) else found
    raise ShapeError(f"Pairs: {name} is needed, but only {', '.join(sorted(known))} were given")


def _about_the_normal(name: str, known: Mapping[str, Tensor], get: Callable[[str], Tensor]) -> Tensor:
    """The half vector's slopes and azimuth, from each other or from the directions."""
    if name == "phi_h":
        if "slope_x" in known:
            return torch.atan2(get("slope_y"), get("slope_x"))
        return phi_h(get("wi"), get("wo"))
    if "phi_h" in known:
        azimuth = get("phi_h")
        return safe_sqrt(get("tan2_h")) * (azimuth.cos() if name == "slope_x" else azimuth.sin())
    return slopes(get("wi"), get("wo"))[name == "slope_y"]


def check_max_theta(max_theta: float) -> None:
    """Refuse a largest angle from the normal that is none.

    Args:
        max_theta: degrees.

    Raises:
        UsageError: it is not above 0 and at most 90.

    Example:
        >>> from torchbrdf.pairs import check_max_theta
        >>> check_max_theta(80.0)
    """
    if not 0 < max_theta <= 90:
        raise UsageError(f"max_theta: expected an angle above 0 and at most 90 degrees, found {max_theta}")
