"""pbrt-v4: a named material, to be included into a scene.

M. Pharr, W. Jakob and G. Humphreys, Physically Based Rendering, 4th ed., 2023, https://pbrt.org.
"""

import copy
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import ClassVar

import numpy as np
import torch
from torch import Tensor

from torchbrdf.export.base import EXPORTERS, Brdf, Exported, Exporter, Material, numbers
from torchbrdf.export.shading import visible
from torchbrdf.export.spectra import WAVELENGTHS, to_spectra
from torchbrdf.files import write_text
from torchbrdf.lobes import GGX, LOBES, BoundedParameter, Lambert, Lobe, ggx
from torchbrdf.lobes.fresnel import conductor
from torchbrdf.lobes.parameter_dict import get_parameters
from torchbrdf.measured import Measured, load, write_rgl
from torchbrdf.measured.tensor_file import TensorFile, write_tensor_file
from torchbrdf.pairs import Pairs

TABLE = "_spec.bsdf"
# Lobes that are pbrt's conductor but for their Fresnel term.
METALS = ("ggx", "ggx_f82")
# How far a metal's reflectance may be from theirs, up to this angle between the directions and the half vector.
LARGEST_ERROR, LARGEST_ANGLE = 0.07, 75.0
# pbrt's own limit, beyond which k would be infinite.
LARGEST_REFLECTANCE = 0.9999

Setting = tuple[str, str | float | bool | Sequence[float]]
"""A parameter of pbrt, with its type and its name: ("float roughness", 0.1)."""


@EXPORTERS.register("pbrt")
class Pbrt(Exporter):
    """A `MakeNamedMaterial`: diffuse, a conductor that comes near a metal, or else a measured one, a table."""

    isotropic_only: ClassVar[bool] = True
    suffix: ClassVar[str] = ".pbrt"
    beside: ClassVar[tuple[str, ...]] = (TABLE,)

    def write(self, material: Material, folder: Path) -> Exported:
        """Write the table, if there has to be one, and the material that names it."""
        path = material.path(folder, self.suffix)
        seen = _only(material.brdf)
        if isinstance(seen, Lambert):
            settings: list[Setting] = [("string type", "diffuse"), ("rgb reflectance", numbers(seen.albedo))]
            notes = ["exact: pbrt's diffuse"]
            write_text(path, to_pbrt(material.name, settings, notes))
            return Exported([path], True, notes, material.brdf)
        metal = None if seen is None else near_conductor(seen)
        if metal is not None:
            notes = [
                "refitted: pbrt's conductor, with the same distribution and shadowing; its Fresnel term is a metal's, "
                f"not Schlick's, and differs by up to {LARGEST_ERROR:g} below {LARGEST_ANGLE:g} degrees"
            ]
            write_text(path, to_pbrt(material.name, metal.settings(), notes))
            return Exported([path], False, notes, metal)
        table = material.path(folder, TABLE)
        shown = write_spectra(table, material)
        notes = [
            f"a table: {len(WAVELENGTHS)} wavelengths, of which a white light makes the same colours; pbrt looks for "
            f"{table.name} beside the scene"
        ]
        write_text(path, to_pbrt(material.name, [("string type", "measured"), ("string filename", table.name)], notes))
        return Exported([path, table], False, notes, shown)


class PbrtConductor(Lobe):
    """pbrt's conductor: GGX with correlated shadowing, and Fresnel's equations with eta = 1 and k for a reflectance.

    Example:
        >>> from torchbrdf.export.pbrt import PbrtConductor
        >>> PbrtConductor(reflectance=0.5, roughness=0.2)
        PbrtConductor(reflectance=[0.5, 0.5, 0.5], roughness=0.2)
    """

    reflectance: BoundedParameter = BoundedParameter(
        start=0.5, lower=0.0, upper=1.0, shape=(3,), doc="at normal incidence, per channel"
    )
    roughness: BoundedParameter = BoundedParameter(start=0.1, lower=0.001, upper=1.0, log=True, doc="alpha")

    @staticmethod
    def function(pairs: Pairs, reflectance: Tensor, roughness: Tensor) -> Tensor:
        """Values in 1/sr, `(..., N, 3)`."""
        white = torch.ones_like(reflectance)
        return ggx(pairs, white, roughness, white[..., :1]) * reflected(
            reflectance[..., None, :], pairs.cos_d[..., None]
        )

    def settings(self) -> list[Setting]:
        """The parameters of the material."""
        (alpha,) = numbers(self.roughness)
        return [
            ("string type", "conductor"),
            ("rgb reflectance", numbers(self.reflectance)),
            ("float roughness", alpha),
            ("bool remaproughness", False),
        ]


def reflected(reflectance: Tensor, cos_d: Tensor) -> Tensor:
    """The reflectance of pbrt's conductor, of which that at normal incidence is given."""
    known = reflectance.clamp_max(LARGEST_REFLECTANCE)
    return conductor(torch.ones_like(known), 2 * (known / (1 - known)).sqrt(), cos_d)


def near_conductor(lobe: Lobe) -> PbrtConductor | None:
    """The conductor of pbrt that is nearly a metal's lobe; None if there is none so near."""
    if LOBES.name_of(type(lobe)) not in METALS:
        return None
    alpha = get_parameters(lobe)["roughness"].item()
    theta_d = torch.linspace(0, LARGEST_ANGLE, 41, dtype=torch.float64, device="cpu").deg2rad()[None]
    pairs = Pairs.from_half_diff(torch.zeros_like(theta_d), theta_d, torch.full_like(theta_d, torch.pi / 2))
    white = GGX(specular=1.0, roughness=alpha, f0=1.0, dtype=torch.float64)
    exact = copy.deepcopy(lobe).to(torch.float64)
    found = (exact(pairs) / white(pairs))[0].detach()
    if found[0].max() > 1 or (found - reflected(found[0], pairs.cos_d[0, :, None])).abs().max() > LARGEST_ERROR:
        return None
    return PbrtConductor(reflectance=found[0].float(), roughness=alpha)


def _only(brdf: Brdf) -> Lobe | None:
    """The only lobe of a model that is not black; None if it has several, or is a measurement."""
    if not isinstance(brdf, Lobe):
        return None
    part, *more = visible(brdf) or [Lambert(albedo=0.0)]
    return None if more else part


def write_spectra(path: Path, material: Material) -> Measured:
    """Write a table with a spectrum in the place of each colour, the only one that pbrt reads.

    Returns:
        What the table gives under white light.
    """
    with tempfile.TemporaryDirectory() as folder:
        rgb = Path(folder) / "rgb.bsdf"
        write_rgl(rgb, material.brdf, description=material.name)
        file, shown = TensorFile(rgb), load(rgb)
    fields = {name: _plain(file, name) for name in file.fields}
    fields["spectra"] = to_spectra(fields.pop("rgb"), axis=2)
    fields["wavelengths"] = WAVELENGTHS.astype("f4")
    write_tensor_file(path, fields)
    return shown


def _plain(file: TensorFile, name: str) -> np.ndarray:
    """A field as it is in the file."""
    field = file.fields[name]
    return file.array(name, field.shape, field.dtype.kind).astype(field.dtype)


def to_pbrt(name: str, settings: Sequence[Setting], notes: Sequence[str]) -> str:
    """The text of a named material.

    Args:
        name: Of the material.
        settings: Its parameters.
        notes: Comments above it.

    Example:
        >>> from torchbrdf.export.pbrt import to_pbrt
        >>> print(to_pbrt("chalk", [("string type", "diffuse"), ("rgb reflectance", [0.5, 0.5, 0.5])], ["exact"]))
        # exact
        MakeNamedMaterial "chalk"
            "string type" [ "diffuse" ]
            "rgb reflectance" [ 0.5 0.5 0.5 ]
        <BLANKLINE>
    """
    lines = [f"# {note}" for note in notes] + [f"MakeNamedMaterial {_quoted(name)}"]
    lines += [f"    {_quoted(key)} [ {_value(value)} ]" for key, value in settings]
    return "\n".join(lines) + "\n"


def _value(value: str | float | bool | Sequence[float]) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return _quoted(value)
    return " ".join(map(repr, value if isinstance(value, Sequence) else [value]))


def _quoted(text: str) -> str:
    return '"' + text.replace("\\", "\\\\").replace('"', '\\"') + '"'
