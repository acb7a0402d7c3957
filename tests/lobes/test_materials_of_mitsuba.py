"""Lobes that are Mitsuba's own materials, against `bsdf.eval` at random directions."""

from typing import Any

import numpy as np
import pytest
import torch
from helpers.directions import hemisphere

from torchbrdf.lobes import Lobe, Principled, RoughConductor
from torchbrdf.pairs import Pairs

COUNT = 10_000
# Mitsuba works in float32: of (cos_h^2 (a^2 - 1) + 1) of its sharp clear coat few digits are left near the normal.
DEGREES_FROM_MIRROR = 3.0


def rgb(value: list[float]) -> dict[str, Any]:
    return {"type": "rgb", "value": value}


def mitsuba_values(bsdf: dict[str, Any], wi: torch.Tensor, wo: torch.Tensor) -> torch.Tensor:
    """Without the cosine; the viewer is Mitsuba's wi, the light its wo."""
    mi = pytest.importorskip("mitsuba")
    mi.set_variant("scalar_rgb")
    made, context, interaction = mi.load_dict(bsdf), mi.BSDFContext(), mi.SurfaceInteraction3f()
    found = []
    for light, viewer in zip(wi.tolist(), wo.tolist(), strict=True):
        interaction.wi = viewer
        found.append(list(made.eval(context, interaction, light)))
    return torch.tensor(found, dtype=torch.float64) / wi[:, 2:]


def share(material: int, name: str) -> float:
    """Another number in [0, 1] for each parameter of each material."""
    return np.random.default_rng([material, *name.encode()]).uniform()


NAMES = ["metallic", "roughness", "specular", "spec_tint", "sheen", "sheen_tint", "clearcoat", "clearcoat_gloss"]


def principled(material: int, **chosen: float) -> tuple[Lobe, dict[str, Any]]:
    values = {name: 0.05 + 0.95 * share(material, name) for name in [*NAMES, "flatness"]} | chosen
    colour = [share(material, channel) for channel in ("red", "green", "blue")]
    lobe = Principled(base_color=colour, **values, dtype=torch.float64)
    return lobe, {"type": "principled", "base_color": rgb(colour), **values}


def conductor(material: int) -> tuple[Lobe, dict[str, Any]]:
    alpha, colour = 0.02 + share(material, "a"), [share(material, channel) for channel in ("red", "green", "blue")]
    index = {"eta": 0.1 + 3 * share(material, "eta"), "k": 0.5 + 5 * share(material, "k")}
    lobe = RoughConductor(specular=colour, roughness=alpha, **index, dtype=torch.float64)
    return lobe, {
        "type": "roughconductor", "distribution": "ggx", "alpha": alpha, "specular_reflectance": rgb(colour), **index
    }  # fmt: skip


MATERIALS = [
    *[principled(material) for material in range(4)],
    principled(4, metallic=0.0, flatness=0.0, sheen=0.0),
    principled(5, metallic=1.0, clearcoat=0.0),
    principled(6, roughness=0.032, spec_tint=1.0, clearcoat=1.0, clearcoat_gloss=1.0),
    *[conductor(material) for material in range(3)],
]


@pytest.mark.parametrize(("lobe", "bsdf"), MATERIALS, ids=lambda one: type(one).__name__)
def test_values_are_mitsubas(lobe: Lobe, bsdf: dict[str, Any]) -> None:
    wi, wo = (hemisphere(COUNT, seed=seed, dtype=torch.float32).double() for seed in (3, 4))
    pairs = Pairs.from_directions(wi, wo)
    away = (pairs.theta_h.rad2deg() > DEGREES_FROM_MIRROR) & (torch.minimum(wi[:, 2], wo[:, 2]) > 1e-3)
    assert away.double().mean() > 0.99
    expected, found = mitsuba_values(bsdf, wi, wo)[away], lobe(pairs).detach()[away]
    torch.testing.assert_close(found, expected, rtol=1e-4, atol=1e-7)
