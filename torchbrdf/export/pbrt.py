"""pbrt-v4: a named material, to be included into a scene.

M. Pharr, W. Jakob and G. Humphreys, Physically Based Rendering, 4th ed., 2023, https://pbrt.org.
"""

import copy
import math
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import ClassVar

import numpy as np
import torch
from torch import Tensor

from torchbrdf.errors import DataError
from torchbrdf.export.base import EXPORTERS, Brdf, Exported, Exporter, Material, numbers
from torchbrdf.export.grain import along_the_tangent, quarters
from torchbrdf.export.shading import visible
from torchbrdf.export.spectra import WAVELENGTHS, to_spectra
from torchbrdf.files import write_text
from torchbrdf.lobes import GGX, LOBES, BoundedParameter, Lambert, Lobe, Sum, ggx, ggx_anisotropic
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
# The same of a metal with a grain, which has no table in its place.
LARGEST_ERROR_OF_GRAIN = 0.35
# pbrt's own limit, beyond which k would be infinite.
LARGEST_REFLECTANCE = 0.9999

# What is fitted to other lobes with a grain.
NEAREST_GRAIN = "lambert+ggx_anisotropic"

Setting = tuple[str, str | float | bool | Sequence[float] | Sequence[str]]
"""A parameter of pbrt, with its type and its name: ("float roughness", 0.1)."""


@EXPORTERS.register("pbrt")
class Pbrt(Exporter):
    """A `MakeNamedMaterial`: diffuse, a conductor that comes near a metal, or else a measured one, a table.

    A metal with a grain is a conductor of two roughnesses, mixed with what is diffuse beside it.
    """

    suffix: ClassVar[str] = ".pbrt"
    beside: ClassVar[tuple[str, ...]] = (TABLE,)

    def write(self, material: Material, folder: Path) -> Exported:
        """Write the table, if there has to be one, and the material that names it."""
        path = material.path(folder, self.suffix)
        if isinstance(material.brdf, Lobe) and material.brdf.is_anisotropic:
            return write_brushed(path, material, material.brdf)
        seen = _only(material.brdf)
        if isinstance(seen, Lambert):
            settings: list[Setting] = [("string type", "diffuse"), ("rgb reflectance", numbers(seen.albedo))]
            notes = ["exact: pbrt's diffuse"]
            write_text(path, to_pbrt(material.name, settings, notes))
            return Exported([path], True, notes, material.brdf)
        metal = None if seen is None else near_conductor(seen)
        if metal is not None:
            notes = [_fresnel(LARGEST_ERROR)]
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


class PbrtBrushed(Lobe):
    """`PbrtConductor` with a grain, whose axes are the surface's u and v: in a mix, its weight there, else 1.

    Example:
        >>> from torchbrdf.export.pbrt import PbrtBrushed
        >>> PbrtBrushed(reflectance=0.5, roughness_u=0.1, roughness_v=0.4).is_anisotropic
        True
    """

    is_anisotropic: ClassVar[bool] = True
    weight: BoundedParameter = BoundedParameter(start=1.0, lower=0.0, upper=1.0, linear=True, doc="share in a mix")
    reflectance: BoundedParameter = PbrtConductor.reflectance
    roughness_u: BoundedParameter = BoundedParameter(start=0.1, lower=0.001, upper=1.0, log=True, doc="alpha along u")
    roughness_v: BoundedParameter = BoundedParameter(start=0.3, lower=0.001, upper=1.0, log=True, doc="alpha along v")

    @staticmethod
    def function(pairs: Pairs, weight: Tensor, reflectance: Tensor, roughness_u: Tensor, roughness_v: Tensor) -> Tensor:
        """Values in 1/sr, `(..., N, 3)`."""
        white, straight = torch.ones_like(reflectance), torch.zeros_like(roughness_u)
        facets = ggx_anisotropic(pairs, white, roughness_u, roughness_v, straight, white[..., :1])
        return facets * weight[..., None] * reflected(reflectance[..., None, :], pairs.cos_d[..., None])

    def settings(self) -> list[Setting]:
        """The parameters of the material. The roughnesses are alpha; the axes are those of the shape's u and v."""
        return [
            ("string type", "conductor"),
            ("rgb reflectance", numbers(self.reflectance)),
            ("float uroughness", numbers(self.roughness_u)[0]),
            ("float vroughness", numbers(self.roughness_v)[0]),
            ("bool remaproughness", False),
        ]


def write_brushed(path: Path, material: Material, model: Lobe) -> Exported:
    """Write a conductor with a grain, mixed with a diffuse material where there is one.

    pbrt's measured material takes tables of isotropic materials only, and its materials have no rotation: the grain
    lies along the shape's dp/du or across it (pbrt-v4 file format, https://pbrt.org/fileformat-v4, materials).

    Raises:
        DataError: pbrt's conductor is not near the lobe, or there is more than one direction of the grain.
    """
    straight = along_the_tangent(material, model, _has, NEAREST_GRAIN, "pbrt")
    (grain,) = (part for part in visible(straight.model) if part.is_anisotropic)
    black = torch.zeros(3, dtype=torch.float32, device="cpu")
    albedo = next((part.albedo for part in visible(straight.model) if isinstance(part, Lambert)), black)
    share = min(albedo.max().item(), 0.999)
    metal, error = _brushed(grain, 1 - share)
    if error > LARGEST_ERROR_OF_GRAIN:
        raise DataError(
            f"{material.name}: expected a metal for pbrt, which has a grain in its conductor only, found a lobe whose "
            f"reflectance differs from every conductor's by more than {LARGEST_ERROR_OF_GRAIN:g}"
        )
    notes = [*straight.notes, _fresnel(error)]
    if not share:
        text, shown = to_pbrt(material.name, metal.settings(), notes), metal
        write_text(path, text)
        return Exported([path], False, notes, shown)
    names = [f"{material.name}: {part}" for part in ("diffuse", "metal")]
    diffuse = Lambert(albedo=albedo / share)
    parts = [
        to_pbrt(names[0], [("string type", "diffuse"), ("rgb reflectance", numbers(diffuse.albedo))], notes),
        to_pbrt(names[1], metal.settings(), []),
        to_pbrt(material.name, [("string type", "mix"), ("string materials", names), ("float amount", 1 - share)], []),
    ]
    write_text(path, "".join(parts))
    return Exported([path], False, notes, Sum(Lambert(albedo=albedo), metal))


def _has(parts: list[Lobe]) -> bool:
    """Whether pbrt's materials are near: one lobe with a grain, and at most a diffuse one."""
    names = sorted(str(LOBES.name_of(type(part))) for part in parts)
    return names in (["ggx_anisotropic"], ["ggx_anisotropic", "lambert"])


def _fresnel(error: float) -> str:
    """What is said of pbrt's conductor in the place of a lobe."""
    return (
        "refitted: pbrt's conductor, with the same distribution and shadowing; its Fresnel term is a metal's, not "
        f"Schlick's, and differs by up to {error:.2g} below {LARGEST_ANGLE:g} degrees"
    )


def _brushed(lobe: Lobe, weight: float) -> tuple[PbrtBrushed, float]:
    """The conductor that is nearest to a lobe with a grain, in a mix with this weight, and how far it is off."""
    values = {name: value.detach() for name, value in get_parameters(lobe).items()}
    widths = [values["roughness_x"], values["roughness_y"]]
    along, across = widths[::-1] if quarters(lobe) == 1 else widths
    reflectance, error = _reflectance(GGX(specular=values["specular"], roughness=0.3, f0=values["f0"]), weight)
    return PbrtBrushed(weight=weight, reflectance=reflectance, roughness_u=along, roughness_v=across), error


def near_conductor(lobe: Lobe) -> PbrtConductor | None:
    """The conductor of pbrt that is nearly a metal's lobe; None if there is none so near."""
    if LOBES.name_of(type(lobe)) not in METALS:
        return None
    reflectance, error = _reflectance(lobe)
    alpha = get_parameters(lobe)["roughness"].item()
    return None if error > LARGEST_ERROR else PbrtConductor(reflectance=reflectance, roughness=alpha)


def _reflectance(lobe: Lobe, weight: float = 1.0) -> tuple[Tensor, float]:
    """That of the conductor nearest to a metal's lobe, in a mix with this weight, `(3,)`, and how far it is off."""
    alpha = get_parameters(lobe)["roughness"].item()
    theta_d = torch.linspace(0, LARGEST_ANGLE, 41, dtype=torch.float64, device="cpu").deg2rad()[None]
    pairs = Pairs.from_half_diff(torch.zeros_like(theta_d), theta_d, torch.full_like(theta_d, torch.pi / 2))
    white = GGX(specular=1.0, roughness=alpha, f0=1.0, dtype=torch.float64)
    exact = copy.deepcopy(lobe).to(torch.float64)
    found = (exact(pairs) / white(pairs))[0].detach() / weight
    if found[0].max() > 1:
        return found[0].clamp_max(1).float(), math.inf
    error = (found - reflected(found[0], pairs.cos_d[0, :, None])).abs().max().item()
    return found[0].float(), error


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


def _value(value: str | float | bool | Sequence[float] | Sequence[str]) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return _quoted(value)
    if not isinstance(value, Sequence):
        return repr(value)
    return " ".join(_quoted(one) if isinstance(one, str) else repr(one) for one in value)


def _quoted(text: str) -> str:
    return '"' + text.replace("\\", "\\\\").replace('"', '\\"') + '"'
