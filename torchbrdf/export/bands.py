"""Fits in bands of wavelengths as materials in linear RGB, which renderers have."""

import torch
from torch import Tensor

from torchbrdf.export.base import Brdf
from torchbrdf.lobes import FitRecord, Lobe, Sum
from torchbrdf.measured import Measured, StandIn
from torchbrdf.measured.bands import DEFAULT_ILLUMINANT, bands_in_words, colors_label
from torchbrdf.measured.colors import weights_of
from torchbrdf.measured.standin import is_rgb


def in_rgb(record: FitRecord, illuminant: str = DEFAULT_ILLUMINANT) -> tuple[Brdf, list[str]]:
    """What a fit is in linear RGB, and how it became so.

    A lobe that is a colour times a function of the pair is the same lobe of another colour. Of others there are values
    only: they become a table.

    Args:
        record: A fit.
        illuminant: "D65" or "E".

    Returns:
        The model, or values; and notes, none of a fit in linear RGB.

    Raises:
        DataError: Nobody knows the wavelengths of several bands.

    Example:
        >>> from torchbrdf.export.bands import in_rgb
        >>> from torchbrdf.lobes import make_model, parameters
        >>> model = make_model("ward", 1, channels=3)
        >>> record = FitRecord("paint", "ward", 1, parameters(model), wavelengths=[465.0, 525.0, 630.0])
        >>> in_rgb(record)[0].components()[1]
        Ward(specular=[0.5, 0.5, 0.5], roughness=0.01)
    """
    model = record.to_model()
    if is_rgb(record):
        return model, []
    weights = weights_of(record.channels, record.wavelengths, illuminant, record.material)
    bands = bands_in_words(record.channels, record.wavelengths)
    note = f"colours: {colors_label(record.wavelengths or [0.0], illuminant)}, of {bands}"
    if any(part.albedo_spec() is None for part in model.components()):
        settings = {"illuminant": illuminant}
        return Measured(StandIn([record], [], settings)), [f"{note}; colours are no factors of this model: a table"]
    made = [_in_rgb(part, weights) for part in model.components()]
    clamped = any(changed for _, changed in made)
    return Sum(*(part for part, _ in made), shared=model.shared), [note + "; out of gamut, nearest" * clamped]


def _in_rgb(lobe: Lobe, weights: Tensor) -> tuple[Lobe, bool]:
    """A lobe with its colour in RGB, within its bounds; and whether it was outside of them."""
    kind, color = type(lobe).in_rgb, lobe.albedo_spec()
    assert color is not None
    values = {name: getattr(lobe, name).detach() for name in lobe.parameter_specs}
    wanted = values[color.name] @ weights.to(values[color.name])
    values[color.name] = wanted.clamp(color.lower, color.upper)
    return kind(**values), _differ(wanted, values[color.name])


def _differ(one: Tensor, other: Tensor) -> bool:
    return not torch.allclose(one, other, atol=1e-6)
