"""The formulas of renderers' materials, put together as their specifications do, with any number of digits.

Colours are grey here; test_materials.py has those of several channels.
"""

from collections.abc import Callable

import mpmath
import numpy as np
from hypothesis import strategies as st
from mpmath import mpf

from helpers.exact_lobes import (
    EXACT,
    Geometry,
    correlated,
    decades,
    exact_charlie,
    exact_dielectric,
    exact_eon,
    exact_ggx_anisotropic,
    exact_ggx_distribution,
    exact_gtr_distribution,
    f82,
    ggx_lambda,
    separable,
    shares,
    turns,
    unit,
)


def exact_principled(g: Geometry, base: mpf, metallic: mpf, roughness: mpf, specular: mpf, *rest: mpf) -> mpf:
    """Burley's formulas as Mitsuba combines them, of a grey base colour, by which a tint is none."""
    spec_tint, sheen, _, clearcoat, gloss, flatness = rest
    fifth, at_i, at_o = ((1 - c) ** 5 for c in (g.o_h, g.n_i, g.n_o))
    eta = 2 / (1 - mpmath.sqrt(mpf("0.08") * specular)) - 1
    f90 = mpf(1) / 2 + 2 * roughness * g.o_h**2
    # Burley's eq. 4 is the product; Mitsuba adds up its terms as in the course notes of 2015.
    retro = (1 + (f90 - 1) * at_i) * (1 + (f90 - 1) * at_o)
    f_ss90 = roughness * g.o_h**2
    flat = (1 + (f_ss90 - 1) * at_i) * (1 + (f_ss90 - 1) * at_o)
    flat = mpf("1.25") * (flat * (1 / (g.n_i + g.n_o) - mpf(1) / 2) + mpf(1) / 2)
    diffuse = base / mpmath.pi * (retro + flatness * (flat - retro))
    f0 = ((eta - 1) / (eta + 1)) ** 2
    reflected = (1 - metallic) * (1 - spec_tint) * exact_dielectric(g.o_h, eta)
    reflected += metallic * (base + (1 - base) * fifth) + (1 - metallic) * spec_tint * (f0 + (1 - f0) * fifth)
    alpha = max(roughness**2, mpf("0.001"))
    main = exact_ggx_distribution(g, alpha) * separable(g, alpha) * reflected
    width = mpf("0.1") + (mpf("0.001") - mpf("0.1")) * gloss
    shadow = separable(g, mpf(1) / 4) * 4 * g.n_i * g.n_o
    coat = clearcoat / 4 * (mpf("0.04") + mpf("0.96") * fifth) * exact_gtr_distribution(g, width, mpf(1)) * shadow
    return (1 - metallic) * (diffuse + sheen * fifth) + main + coat


def facets(g: Geometry, roughness: mpf) -> mpf:
    return exact_ggx_distribution(g, roughness**2) * correlated(g, ggx_lambda(roughness**2))


def mix(first: mpf, second: mpf, share: mpf) -> mpf:
    return first * (1 - share) + second * share


def schlick(f0: mpf, cosine: mpf) -> mpf:
    return f0 + (1 - f0) * (1 - cosine) ** 5


def within(value: mpf) -> mpf:
    return min(max(value, mpf(0)), mpf(1))


def fitted(x: mpf, y: mpf, powers: list[tuple[int, int]], numbers: list[str]) -> mpf:
    return sum(mpf(number) * x**i * y**j for (i, j), number in zip(powers, numbers, strict=True))


def charlie_albedo(cosine: mpf, alpha: mpf) -> mpf:
    """MaterialX' `mx_imageworks_sheen_dir_albedo_analytic`."""
    powers = [(0, 0), (1, 0), (0, 1), (1, 1), (2, 0), (0, 2)]
    above = fitted(
        cosine, alpha, powers, ["13.67300", "-68.78018", "799.08825", "-905.00061", "60.28956", "1086.96473"]
    )
    below = fitted(cosine, alpha, powers, ["1", "61.57746", "442.78211", "2597.49308", "121.81241", "3045.55075"])
    return within(above / below)


def ggx_albedo(cosine: mpf, alpha: mpf, f0: mpf) -> mpf:
    """MaterialX' `mx_ggx_dir_albedo_analytic`, of F90 = 1."""
    powers = [(0, 0), (1, 0), (0, 1), (1, 1), (2, 0), (0, 2), (2, 1), (1, 2), (2, 2)]
    columns = zip(
        ["0.1003", "0.9345", "1.0", "1.0"],
        ["-0.6303", "-2.323", "-1.765", "0.2281"],
        ["9.748", "2.229", "8.263", "15.94"],
        ["-2.038", "-3.748", "11.53", "-55.83"],
        ["29.34", "1.424", "28.96", "13.08"],
        ["-8.245", "-0.7684", "-7.507", "41.26"],
        ["-26.44", "1.436", "-36.11", "54.9"],
        ["19.99", "0.2913", "15.86", "300.2"],
        ["-5.448", "0.6286", "33.37", "-285.1"],
        strict=True,
    )
    a, b, below_a, below_b = (fitted(cosine, alpha, powers, list(numbers)) for numbers in columns)
    return f0 * within(a / below_a) + within(b / below_b)


def light_and_viewer(g: Geometry) -> tuple[list[mpf], list[mpf]]:
    """The viewer counts as the lower one."""
    return (g.wi, g.wo) if g.n_o <= g.n_i else (g.wo, g.wi)


def exact_gltf(g: Geometry, base: mpf, metallic: mpf, roughness: mpf, specular: mpf, tint: mpf, *rest: mpf) -> mpf:
    """Appendix B of the specification, and the extensions' functions."""
    return gltf_over(g, facets(g, roughness), base, metallic, specular, tint, *rest)


def grain_facets(g: Geometry, x: mpf, y: mpf, rotation: mpf) -> mpf:
    """GGX with a grain, of alphas."""
    return exact_ggx_anisotropic(g, mpf(1), x, y, rotation, mpf(1))


def exact_gltf_anisotropic(g: Geometry, base: mpf, metallic: mpf, x: mpf, y: mpf, rotation: mpf, *rest: mpf) -> mpf:
    """The same with the facets of KHR_materials_anisotropy, by its strength and its rotation."""
    wide, narrow = max(x, y) ** 2, min(x, y) ** 2
    strength = mpmath.sqrt((wide - narrow) / (1 - narrow)) if wide > narrow else mpf(0)
    turn = rotation if x > y else rotation + mpmath.pi / 2
    main = grain_facets(g, mix(narrow, mpf(1), strength**2), narrow, turn)
    return gltf_over(g, main, base, metallic, *rest)


def gltf_over(g: Geometry, main: mpf, base: mpf, metallic: mpf, specular: mpf, tint: mpf, *rest: mpf) -> mpf:
    """The material of the base's facets."""
    ior, clearcoat, coat_roughness, sheen, sheen_roughness = rest
    viewer = light_and_viewer(g)[1][2]
    f0 = min(((1 - ior) / (1 + ior)) ** 2 * tint, mpf(1))
    reflected = schlick(f0, g.o_h)
    dielectric = (1 - specular * reflected) * base / mpmath.pi + specular * reflected * main
    metal = main * schlick(base, g.o_h)
    material = mix(dielectric, metal, metallic)
    alpha = sheen_roughness**2
    scaling = min(1 - sheen * charlie_albedo(cosine, alpha) for cosine in (g.n_i, g.n_o))
    material = exact_charlie(g, sheen, alpha) + scaling * material
    return mix(material, facets(g, coat_roughness), clearcoat * schlick(mpf("0.04"), viewer))


def fuzz_albedo(cosine: mpf, y: mpf) -> mpf:
    """MaterialX' `mx_zeltner_sheen_dir_albedo`."""
    width = y * (mpf("0.0206607") + mpf("1.58491") * y) / (mpf("0.0379424") + y * (mpf("1.32227") + y))
    middle = mpf("-0.193854") + y * (mpf("-1.14885") + y * (mpf("1.7932") - mpf("0.95943") * y * y))
    middle *= y / (mpf("0.046391") + y)
    least = y * (mpf("0.000654023") + (mpf("-0.0207818") + mpf("0.119681") * y) * y)
    least /= mpf("1.26264") + y * (mpf("-1.92021") + y)
    away = min(((cosine - middle) / width) ** 2, mpf(150))
    return mpmath.exp(-away / 2) / (width * mpmath.sqrt(2 * mpmath.pi)) + least


def fuzz(g: Geometry, y: mpf) -> mpf:
    """A linearly transformed cosine, in the frame whose x axis is that of the viewer's azimuth."""
    light, viewer = light_and_viewer(g)
    x = viewer[2]
    a = (mpf("2.58126") * x + mpf("0.813703") * y) * y / (1 + mpf("0.310327") * x * x + mpf("2.60994") * x * y)
    b = mpmath.sqrt(1 - x) * (y - 1) * y**3
    b /= mpf("0.0000254053") + mpf("1.71228") * x - mpf("1.71506") * x * y + mpf("1.34174") * y * y
    sine = mpmath.sqrt(viewer[0] ** 2 + viewer[1] ** 2)
    axis = [viewer[0] / sine, viewer[1] / sine] if sine else [mpf(1), mpf(0)]
    along = light[0] * axis[0] + light[1] * axis[1]
    across = light[1] * axis[0] - light[0] * axis[1]
    turned = [a * along + b * light[2], a * across, light[2]]
    square = sum(one**2 for one in turned)
    density = light[2] / mpmath.pi * (a / square) ** 2
    return fuzz_albedo(x, y) * density / light[2]


def exact_openpbr(g: Geometry, *values: mpf) -> mpf:
    """The reference graph of MaterialX, node by node."""
    roughness = openpbr_below_coat(values[5], values[7], values[9])
    return openpbr_over(g, facets(g, roughness), roughness**2, *values[:5], *values[6:])


def openpbr_below_coat(roughness: mpf, coat_weight: mpf, coat_roughness: mpf) -> mpf:
    return mix(roughness, min(mpf(1), 2 * coat_roughness**4 + roughness**4) ** (mpf(1) / 4), coat_weight)


def exact_openpbr_anisotropic(g: Geometry, *values: mpf) -> mpf:
    """The same with `open_pbr_anisotropy`, of a roughness and its anisotropy."""
    x, y, rotation = values[5:8]
    wide, narrow = max(x, y) ** 2, min(x, y) ** 2
    anisotropy = 1 - narrow / wide
    turn = rotation if x > y else rotation + mpmath.pi / 2
    own = mpmath.sqrt(wide * mpmath.sqrt((1 + (1 - anisotropy) ** 2) / 2))
    roughness = openpbr_below_coat(own, values[9], values[11])
    along = roughness**2 * mpmath.sqrt(2 / (1 + (1 - anisotropy) ** 2))
    across = (1 - anisotropy) * along
    main = grain_facets(g, along, across, turn)
    return openpbr_over(g, main, mpmath.sqrt(along * across), *values[:5], *values[8:])


def openpbr_over(g: Geometry, main: mpf, alpha: mpf, *values: mpf) -> mpf:
    """The surface of the base's facets, and of their alpha."""
    base_color, base_diffuse_roughness, base_metalness, specular_weight, specular_color, *rest = values
    specular_ior, coat_weight, coat_color, coat_roughness, coat_ior, darkening, *rest = rest
    fuzz_weight, fuzz_color, fuzz_roughness = rest
    viewer = light_and_viewer(g)[1][2]
    ratio = specular_ior / coat_ior
    eta_s = mix(specular_ior, ratio if ratio > 1 else 1 / ratio, coat_weight)
    epsilon = mpmath.sign(eta_s - 1) * mpmath.sqrt(specular_weight * ((eta_s - 1) / (eta_s + 1)) ** 2)
    eta = (1 + epsilon) / (1 - epsilon)
    coat_f0 = ((coat_ior - 1) / (coat_ior + 1)) ** 2
    diffuse = exact_eon(g, base_color, base_diffuse_roughness)
    glossy = main * exact_dielectric(g.o_h, eta) * specular_color
    dielectric = glossy + (1 - ggx_albedo(viewer, alpha, epsilon**2)) * diffuse
    metal = specular_weight * main * f82(g, base_color, specular_color)
    material = mix(dielectric, metal, base_metalness)
    k = 1 - (1 - coat_f0) / coat_ior**2
    albedo = mix(base_color, base_color * specular_weight, base_metalness)
    material *= mix(mpf(1), (1 - k) / (1 - albedo * k), coat_weight * darkening) * mix(mpf(1), coat_color, coat_weight)
    coat = coat_weight * facets(g, coat_roughness) * exact_dielectric(g.o_h, coat_ior)
    material = coat + (1 - coat_weight * ggx_albedo(viewer, coat_roughness**2, coat_f0)) * material
    cover = fuzz_weight * fuzz_color * fuzz(g, fuzz_roughness)
    return cover + (1 - fuzz_weight * fuzz_albedo(viewer, fuzz_roughness)) * material


COSINES = np.maximum(np.linspace(0, 1, 64), 1e-6)[:, None, None]


def masked(cosine: np.ndarray, alpha: float) -> np.ndarray:
    """Smith's G1 of GGX."""
    return 2 * cosine / (cosine + np.sqrt(alpha**2 + (1 - alpha**2) * cosine**2))


def facets_of(
    alpha: float, low: np.ndarray, high: np.ndarray, least: Callable[[np.ndarray], np.ndarray] | None = None
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Cosines to light and normal of facets whose angles from the normal are between low and high, and their weights.

    The rule that the lobe documents, at each of Mitsuba's cosines; least: of the cosine to the light, by the other one.
    """
    x, w = np.polynomial.legendre.leggauss(10 if least is None else 12)
    x, w = (x[:, None] + 1) / 2, w[:, None] / 2
    if least is not None:
        x, w = 3 * x**2 - 2 * x**3, 6 * (x - x**2) * w
    ends = [np.arcsinh(np.arctan2(alpha * np.cos(one), np.sin(one)) / alpha) for one in (high, low)]
    at = ends[0] + (ends[1] - ends[0]) * x
    d = alpha * np.sinh(at)
    w = w * (ends[1] - ends[0]) * alpha * np.cosh(at) * 2 * np.sin(d) * np.cos(d)
    theta = np.arctan2(alpha * np.cos(d), np.sin(d))
    sine = np.sqrt((1 - COSINES) * (1 + COSINES))
    if least is None:
        turn, part = (np.arange(6) + 0.5) * np.pi / 6, np.full(6, 1 / 6)
    else:
        nodes, parts = (half[6:] for half in np.polynomial.legendre.leggauss(12))
        room = 4 * np.finfo(float).eps
        end = (least(np.cos(theta)) - COSINES * np.cos(theta)) / (np.maximum(sine, 1e-12) * np.sin(theta))
        end = np.arccos(np.clip(end, room - 1, 1 - room))
        turn, part = end * (3 * nodes - nodes**3) / 2, end * 1.5 * (1 - nodes**2) * parts / np.pi
    cosine = np.clip(sine * np.sin(theta) * np.cos(turn) + COSINES * np.cos(theta), 0, 1)
    return cosine, np.cos(theta), w * part * masked(COSINES, alpha) / COSINES * cosine / np.cos(theta)


def let_through(n: float, outside: np.ndarray, inside: np.ndarray) -> np.ndarray:
    """1 less the mean of both polarizations."""
    across = (outside - n * inside) / (outside + n * inside)
    along = (n * outside - inside) / (n * outside + inside)
    return 1 - (across**2 + along**2) / 2


def shares_of_plastic(alpha: float, n: float) -> tuple[np.ndarray, float]:
    """What the coat lets in at each of Mitsuba's cosines, and out of diffuse light."""
    angle = np.arctan2(np.sqrt((1 - COSINES) * (1 + COSINES)), COSINES)
    into, out = 0.0, 1.0
    right = np.pi / 2 + 0 * angle
    for c, m, w in (facets_of(alpha, 0 * angle, right - angle), facets_of(alpha, right - angle, right, np.zeros_like)):
        inside = np.sqrt(1 - (1 - c**2) / n**2)
        down = (inside - c / n) * m + COSINES / n
        into = into + (w * let_through(n, c, inside) * masked(down, alpha)).sum((1, 2))
    critical = np.sqrt(1 - 1 / n**2)
    first, last, limit = np.pi / 4 - angle / 2, np.pi / 4 + angle / 2, np.arccos(critical)
    near, far = np.minimum(np.maximum(limit - angle, 0), first), np.minimum(angle + limit, last)
    start = np.minimum(np.maximum(near, angle - limit), far)
    back = [facets_of(alpha, 0 * angle, first), facets_of(alpha, first, last, lambda m: COSINES / (2 * m))]
    left = [
        facets_of(alpha, 0 * angle, near),
        facets_of(alpha, start, far, lambda m: np.maximum(COSINES / (2 * m), critical)),
    ]
    for sign, seen in ((-1, back), (1, left)):
        for c, m, w in seen:
            outside = np.sqrt(np.maximum(1 - n**2 * (1 - c**2), 1e-12))
            factor = let_through(n, outside, c) if sign > 0 else 1
            up = np.maximum(2 * c * m - COSINES, 0)
            out = out + sign * (w * factor * masked(up, alpha)).sum((1, 2))
    return into, float(2 * (out * COSINES[:, 0, 0]).mean())


def exact_roughplastic(g: Geometry, base: mpf, specular: mpf, alpha: mpf, ior: mpf) -> mpf:
    """Mitsuba's terms; its tables are linear between their cosines."""
    into, out = shares_of_plastic(float(alpha), float(ior))
    share = mpf(1)
    for cosine in (g.n_i, g.n_o):
        low = min(int(mpmath.floor(63 * cosine)), 62)
        share *= mix(mpf(into[low]), mpf(into[low + 1]), 63 * cosine - low)
    main = exact_ggx_distribution(g, alpha) * separable(g, alpha) * exact_dielectric(g.o_h, ior)
    return specular * main + base * share / (mpmath.pi * ior**2 * out)


rough, ior = decades(0.032, 1), st.floats(1.05, 3)

MATERIALS: dict[str, tuple[Callable[..., mpf], list[st.SearchStrategy]]] = {
    "principled": (exact_principled, [shares, unit, rough, st.floats(0.05, 1), *[unit] * 6]),
    "roughplastic": (exact_roughplastic, [shares, unit, decades(0.001, 1), st.floats(1.05, 3)]),
    "gltf": (exact_gltf, [shares, unit, rough, unit, unit, ior, unit, rough, unit, st.floats(0.1, 1)]),
    "gltf_anisotropic": (
        exact_gltf_anisotropic,
        [shares, unit, rough, rough, turns, unit, unit, ior, unit, rough, unit, st.floats(0.1, 1)],
    ),
    "openpbr_anisotropic": (
        exact_openpbr_anisotropic,
        [
            *[shares, st.one_of(st.just(0.0), shares), unit, shares, st.floats(0.52, 1), rough, rough, turns, ior],
            *[unit, unit, rough, ior, unit],
            *[unit, unit, st.floats(0.01, 1)],
        ],
    ),
    "openpbr": (
        exact_openpbr,
        [
            *[shares, st.one_of(st.just(0.0), shares), unit, shares, st.floats(0.52, 1), rough, ior],
            *[unit, unit, rough, ior, unit],
            *[unit, unit, st.floats(0.01, 1)],
        ],
    ),
}
EXACT |= MATERIALS
