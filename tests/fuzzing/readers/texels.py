"""Photometric stacks: the table of lights, and the pictures that it names."""

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch

from fuzzing.changes.byte import TEXT
from fuzzing.changes.of_table import TABLE
from fuzzing.readers import Reader
from fuzzing.sane import check_finite, expect
from torchbrdf.errors import DataError
from torchbrdf.images import write_exr
from torchbrdf.lobes import make_model
from torchbrdf.texels import dome, fit_texels
from torchbrdf.texels.pictures import Light, read_lights, stacked

SIDE, LIGHTS = 4, 6


def make_stack(folder: Path) -> None:
    lines = ["file,x,y,z,r,g,b"]
    for k, (x, y, z) in enumerate(dome(LIGHTS).tolist()):
        write_exr(folder / f"{k}.exr", torch.full((SIDE, SIDE, 3), 0.3 * z, dtype=torch.float32))
        lines.append(f"{k}.exr,{x:.6f},{y:.6f},{z:.6f},1,1,{1 + 0.1 * k:g}")
    (folder / "fuzzed.csv").write_text("\n".join(lines) + "\n")


def use_stack(path: Path) -> None:
    """As `torchbrdf texels` does, with few steps."""
    lights = read_lights(path)
    for light in lights:
        expect(all(map(math.isfinite, (*light.direction, *light.irradiance))), "a light that is not finite")
        expect(min(light.irradiance) > 0, "an irradiance of 0")
    try:
        _fit(path.parent, lights)
    except DataError as error:  # which names a picture, or the lights
        raise DataError(f"{path}: {error}") from None


def _fit(folder: Path, lights: Sequence[Light]) -> None:
    with stacked(lights, folder) as (stack, _):
        directions, irradiance = [one.direction for one in lights], [one.irradiance for one in lights]
        maps = fit_texels(stack, directions, irradiance=irradiance, model=make_model("ward", 1), max_iterations=2)
        albedo = maps["albedo"]
        known = albedo[np.isfinite(albedo).all(-1)]
        check_finite(torch.from_numpy(known), "albedo")
        expect(bool(((known >= 0) & (known <= 1)).all()), "an albedo that cannot be")


READERS = (Reader("stack", "fuzzed.csv", make_stack, use_stack, (*TEXT, *TABLE), share=0.5),)
