"""Published fits by plain formulas, from the numbers as their files have them."""

from typing import Any

import numpy as np
import torch
from scipy import special

from helpers.directions import hemisphere

Array = np.ndarray


def directions() -> tuple[Array, Array]:
    """Directions up to 85 degrees, of which half are about each other's mirror direction."""
    wi = hemisphere(400, seed=1)
    wi = wi[wi[:, 2] > 0.1]
    wo = hemisphere(len(wi), seed=2)
    near = wi * torch.tensor([-1.0, -1.0, 1.0], dtype=torch.float64) + 0.05 * hemisphere(len(wi), seed=3)
    wo[::2] = (near / near.norm(dim=-1, keepdim=True))[::2]
    keep = wo[:, 2] > 0.1
    return wi[keep].numpy(), wo[keep].numpy()


class Angles:
    """The quantities of the conventions' table, from the directions."""

    def __init__(self, wi: Array, wo: Array) -> None:
        half = (wi + wo) / np.linalg.norm(wi + wo, axis=1, keepdims=True)
        self.zi, self.zo, self.zh = wi[:, 2], wo[:, 2], half[:, 2]
        self.vh = (wi * half).sum(1)
        self.level = (wi * wo)[:, :2].sum(1)
        self.sum2, self.difference2 = (((wi + sign * wo)[:, :2] ** 2).sum(1) for sign in (1, -1))
        self.tan2 = (half[:, 0] ** 2 + half[:, 1] ** 2) / half[:, 2] ** 2
        self.masking = np.minimum(1, 2 * self.zh * np.minimum(self.zi, self.zo) / self.vh)

    def schlick(self, f0: float) -> Array:
        return f0 + (1 - f0) * (1 - self.vh) ** 5


def plain_ward(g: Angles, fit: dict[str, Any]) -> Array:
    a = fit["roughness"]
    return np.outer(np.exp(-g.tan2 / a**2) / (4 * np.pi * a**2 * np.sqrt(g.zi * g.zo)), fit["specular"])


def plain_ward_duer(g: Angles, fit: dict[str, Any]) -> Array:
    return plain_ward(g, fit) / np.sqrt(g.zi * g.zo)[:, None]


def plain_blinn_phong(g: Angles, fit: dict[str, Any]) -> Array:
    n = fit["sharpness"]
    return np.outer((n + 2) / (2 * np.pi) * g.zh**n, fit["specular"])


def plain_cook_torrance(g: Angles, fit: dict[str, Any]) -> Array:
    m = fit["roughness"]
    d = np.exp(-g.tan2 / m**2) / (np.pi * m**2 * g.zh**4)
    return np.outer(g.schlick(fit["eta"]) * d * g.masking / (np.pi * g.zi * g.zo), fit["specular"])


def plain_ashikhmin_shirley(g: Angles, fit: dict[str, Any]) -> Array:
    n = fit["sharpness"]
    power = (n + 1) / (8 * np.pi) * g.zh**n / (g.vh * np.maximum(g.zi, g.zo))
    return np.outer(power * g.schlick(fit["fresnelReflectance"]), fit["specular"])


def plain_lafortune(g: Angles, fit: dict[str, Any]) -> Array:
    n, largest = fit["sharpness"], max(-fit["Cxy"], fit["Cz"])
    base = np.maximum(0, fit["Cxy"] * g.level + fit["Cz"] * g.zi * g.zo) / largest
    return np.outer((n + 2) / (2 * np.pi) * base**n, fit["specular"])


def plain_he(g: Angles, fit: dict[str, Any]) -> Array:
    """All terms of the sum that count, one by one."""
    sigma0, tau, n = fit["roughness"] / 0.65, fit["autocorrelation"] / 0.65, max(fit["eta"], 1.0)
    shadow, k = 1.0, 0.0
    for z in (g.zi, g.zo):
        tangent = np.sqrt(1 - z**2) / z
        v = tau / (2 * sigma0 * tangent)
        slope = np.exp(-(v**2)) / (2 * v * np.sqrt(np.pi)) - special.erfc(v) / 2
        shadow, k = shadow * (1 - special.erfc(v) / 2) / (1 + slope), k + tangent * special.erfc(v)
    sigma = sigma0 / np.sqrt(1 + special.lambertw(k**2 / (8 * np.pi)).real)
    height = (2 * np.pi * sigma * (g.zi + g.zo)) ** 2
    x = (np.pi * tau) ** 2 * (g.zi + g.zo) ** 2 * g.tan2
    total = np.zeros_like(x)
    for m in range(1, int(height.max() + 40 * np.sqrt(height.max()) + 200)):
        total += np.exp(m * np.log(height) - height - x / m - special.gammaln(m + 1)) / m
    d = (np.pi * tau) ** 2 / 4 * total
    bent = (2 * g.vh / g.zh) ** 2 * shadow * plain_fresnel(g.vh, n)
    return np.outer(bent * d / (np.pi * g.zi * g.zo), fit["specular"])


def plain_fresnel(cosine: Array, n: float) -> Array:
    refracted = np.sqrt(1 - (1 - cosine**2) / n**2)
    across = (cosine - n * refracted) / (cosine + n * refracted)
    along = (n * cosine - refracted) / (n * cosine + refracted)
    return (across**2 + along**2) / 2


def plain_low_smooth(g: Angles, fit: dict[str, Any]) -> Array:
    s = plain_fresnel(np.sqrt(1 - g.difference2 / 4), fit["eta"]) / (1 + fit["B"] * g.sum2) ** fit["C"]
    return np.outer(s, fit["A"])


def plain_low_cook_torrance(g: Angles, fit: dict[str, Any]) -> Array:
    m = fit["roughness"]
    d = np.exp(-g.tan2 / m**2) / (m**2 * g.zh**4)
    return np.outer(plain_fresnel(g.vh, fit["eta"]) * d * g.masking / (np.pi * g.zi * g.zo), fit["specular"])


def plain_low_ashikhmin_shirley(g: Angles, fit: dict[str, Any]) -> Array:
    n = fit["sharpness"]
    power = (n + 1) / (8 * np.pi) * g.zh**n / (g.vh * np.maximum(g.zi, g.zo))
    return np.outer(power * plain_fresnel(g.vh, fit["fresnelReflectance"]), fit["specular"])


def plain_low(g: Angles, fit: dict[str, Any]) -> Array:
    s = np.outer(1 / (1 + fit["B"] * (1 - g.zh)) ** fit["C"], fit["A"])
    return s * (g.masking * plain_fresnel(g.vh, fit["eta"]) / (np.pi * g.zi * g.zo))[:, None]


def plain_bagher(g: Angles, fit: dict[str, Any]) -> Array:
    return np.stack([plain_bagher_channel(g, fit, c) for c in range(3)], -1)


def plain_bagher_channel(g: Angles, fit: dict[str, Any], c: int) -> Array:
    alpha, p, k = fit["alpha"][c], fit["p"][c], fit["k"][c]
    t = alpha + g.tan2 / alpha
    value = fit["specular"][c] * fit["K"][c] * np.exp(-t) / t**p / (np.pi * g.zh**4)
    for z in (g.zi, g.zo):
        with np.errstate(over="ignore"):
            shadow = np.exp(fit["c"][c] * np.maximum(0, np.arccos(z) - fit["theta0"][c]) ** k)
        value = value * np.maximum(0, 1 + fit["Lambda"][c] * (1 - shadow))
    f0, f1 = fit["eta"][0][c], fit["eta"][1][c]
    return value * np.maximum(0, g.schlick(f0) - f1 * g.vh) / (np.pi * g.zi * g.zo)


PLAIN = {
    "ngan_ward": plain_ward,
    "ngan_wardduer": plain_ward_duer,
    "ngan_blinnphong": plain_blinn_phong,
    "ngan_cooktorrance": plain_cook_torrance,
    "ngan_ashikhminshirley": plain_ashikhmin_shirley,
    "ngan_lafortune": plain_lafortune,
    "ngan_he": plain_he,
    "low_cooktorrance_E1": plain_low_cook_torrance,
    "low_cooktorrance_E2": plain_low_cook_torrance,
    "low_ashikhminshirley_E1": plain_low_ashikhmin_shirley,
    "low_ashikhminshirley_E2": plain_low_ashikhmin_shirley,
    "low_lowmicrofacet_E2": plain_low,
    "low_lowsmooth_E2": plain_low_smooth,
    "bagher_sgd": plain_bagher,
}
