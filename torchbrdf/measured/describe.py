"""What there is to say about a file of measured BRDFs."""

import math
from collections.abc import Mapping
from pathlib import Path

import torch

from torchbrdf.errors import DataError
from torchbrdf.lobes.zoo import is_zoo
from torchbrdf.measured.gloss import contrast_gloss, distinctness_of_image
from torchbrdf.measured.load import load
from torchbrdf.measured.measured import Measured
from torchbrdf.measured.plausibility import directional_albedo

FURNACE = (0.0, 60.0)
"""Angles of the light, in degrees, at which it is said how much of it is reflected, in any channel, where readers have
to take something that files do not say."""


def describe(path: str | Path, settings: Mapping[str, str] | None = None) -> dict[str, object]:
    """Facts about one file of measured BRDFs: sizes, validity, diffuse albedo, gloss, range of values.

    Args:
        path: The file; or a name in the zoo, such as `zoo:nickel`.
        settings: What the file does not say, as of `load`.

    Returns:
        Facts by name, in an order to print. Lists have one entry a channel, figures that do not exist are None, and
        formats add what only they know. Where a file has several materials, each has its facts under its name.

    Raises:
        DataError: The file is no measured BRDF.
    """
    measured = load(path, dtype=torch.float64, settings=settings)
    facts: dict[str, object] = {
        "format": measured.source.format,
        **({} if is_zoo(path) else {"bytes": Path(path).stat().st_size}),
        "materials": measured.names,
    }
    each = {name: _material(measured.batch([k])) for k, name in enumerate(measured.names)}
    return facts | (each if len(each) > 1 else each[measured.names[0]])


def _material(measured: Measured) -> dict[str, object]:
    values, valid = measured.values[0], measured.weight[0, :, 0] > 0
    if not valid.any():
        raise DataError(f"{measured.names[0]}: expected valid samples, found none")
    facts: dict[str, object] = {
        "samples": len(valid),
        "valid samples": int(valid.sum()),
        "lowest value, 1/sr": values[valid].amin(0).tolist(),
        "highest value, 1/sr": values[valid].amax(0).tolist(),
        "diffuse albedo pi f(45:0)": measured.diffuse_45_0()[0].tolist() if measured.has_45_0.all() else None,
        "distinctness of image, degrees": _finite(distinctness_of_image(measured)[0].item()),
        "contrast gloss": _finite(contrast_gloss(measured)[0].item()),
    }
    facts |= measured.source.details(measured.materials[0])
    if measured.source.settings:  # by which it can be told whether what was taken is right
        albedo = directional_albedo(measured, FURNACE)[0].amax(-1).tolist()
        facts |= {
            f"white furnace: albedo at {angle:g} degrees": one for angle, one in zip(FURNACE, albedo, strict=True)
        }
    return facts


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None
