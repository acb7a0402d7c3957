"""Fits that others published: parameters of Lambert plus one lobe for the MERL materials.

The file is JSON, `{set: {material: {"diffuse": [R, G, B], "model": ..., parameters}}}`, as collected from the folder
fits/ of https://github.com/bsdfbenchmark/bbm, whose reading of each set is followed here, but for what `SETS` says.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from torchbrdf.errors import DataError, UsageError, shown
from torchbrdf.lobes import LOBES, Lambert, Sum
from torchbrdf.lobes.parameter_dict import get_parameters, take_materials, with_parameters
from torchbrdf.measured.merl import CHANNEL_FACTORS
from torchbrdf.names import check_name
from torchbrdf.reading import exists, read_json

ORIGIN = "the fits of https://github.com/bsdfbenchmark/bbm, folder fits/, collected as one JSON file"
NGAN = "A. Ngan, F. Durand and W. Matusik, Experimental Analysis of BRDF Models, 2005, doi:10.2312/EGWR/EGSR05/117-126"
LOW = (
    "J. Low, J. Kronander, A. Ynnerman and J. Unger, BRDF Models for Accurate and Efficient Rendering of Glossy "
    "Surfaces, 2012, doi:10.1145/2077341.2077350"
)
BAGHER = (
    "M. Bagher, C. Soler and N. Holzschuch, Accurate Fitting of Measured Reflectances Using a Shifted Gamma "
    "Micro-facet Distribution, 2012, doi:10.1111/j.1467-8659.2012.03147.x"
)

COLOR, NUMBER = (3,), (1,)
# Albedos, of at least 0 in every set; and what no number of a fit goes beyond, but for Bagher's c of up to 1e109.
ALBEDOS = ("diffuse", "specular", "A")
LARGEST, LARGEST_C = 1e10, 1e300
# What a number above 0 is at least: widths of lobes are divided by.
SMALLEST = 1e-12
# Of the lengths of He's model as Ngan et al. fitted it: with this wavelength their fits come nearest to the tables.
WAVELENGTH = 0.65
Numbers = dict[str, Tensor]


@dataclass(frozen=True)
class _Reading:
    """How one set is read.

    model: the `model` of each fit; lobe: a registered one; fields: the shape of each number of a fit; positive: those
    that must be above 0; negative: below it; parameters: from fields, `(M, k)`, to the lobe's parameters; raw: whether
    the fits lack MERL's CHANNEL_FACTORS; reflectance: the field that is one, from 0 to 1.
    """

    source: str
    model: str
    lobe: str
    fields: dict[str, tuple[int, ...]]
    positive: tuple[str, ...]
    parameters: Callable[[Numbers], Numbers]
    raw: bool = False
    reflectance: str = ""
    negative: tuple[str, ...] = ()


def _bagher(fit: Numbers) -> Numbers:
    f0, f1 = fit["eta"].unbind(-2)
    return {
        "specular": fit["specular"],
        "alpha": fit["alpha"],
        "p": fit["p"],
        "normalization": fit["K"],
        "f0": f0,
        "f1": f1,
        "shadow": fit["Lambda"],
        "reach": (-fit["c"].log() / fit["k"]).exp(),
        "steepness": fit["k"],
        "onset": fit["theta0"],
    }


# E1 and E2 are the errors that Low et al. minimised: of values times cosines, and of the logarithm of 1 and that.
LOW_COOK_TORRANCE = _Reading(
    LOW,
    "LowCookTorrance",
    "cook_torrance_ior",
    {"specular": COLOR, "roughness": NUMBER, "eta": NUMBER},
    ("roughness", "eta"),
    lambda fit: {"specular": fit["specular"], "roughness": fit["roughness"], "ior": fit["eta"]},
)
# Its `fresnelReflectance` is an index of refraction.
LOW_ASHIKHMIN_SHIRLEY = _Reading(
    LOW,
    "LowAshikhminShirley",
    "ashikhmin_shirley_ior",
    {"specular": COLOR, "sharpness": NUMBER, "fresnelReflectance": NUMBER},
    ("sharpness", "fresnelReflectance"),
    lambda fit: {"specular": fit["specular"], "exponent": fit["sharpness"], "ior": fit["fresnelReflectance"]},
)

SETS = {
    "ngan_ward": _Reading(
        NGAN,
        "NganWard",
        "ward",
        {"specular": COLOR, "roughness": NUMBER},
        ("roughness",),
        lambda fit: {"specular": fit["specular"], "roughness": fit["roughness"]},
        raw=True,
    ),
    "ngan_wardduer": _Reading(
        NGAN,
        "NganWardDuer",
        "duer",
        {"specular": COLOR, "roughness": NUMBER},
        ("roughness",),
        lambda fit: {"specular": fit["specular"], "roughness": fit["roughness"]},
        raw=True,
    ),
    # BBM evaluates a power of the mirror direction's cosine; the numbers are those of the half vector's: n is about
    # 2 / alpha^2 of ngan_ward, and would be a quarter of it.
    "ngan_blinnphong": _Reading(
        NGAN,
        "NganBlinnPhong",
        "blinn_phong",
        {"specular": COLOR, "sharpness": NUMBER},
        ("sharpness",),
        lambda fit: {"specular": fit["specular"], "exponent": fit["sharpness"]},
        raw=True,
    ),
    # Its distribution has the 1/pi that ours, the paper's, has not; its `eta` is a reflectance.
    "ngan_cooktorrance": _Reading(
        NGAN,
        "NganCookTorrance",
        "cook_torrance",
        {"specular": COLOR, "roughness": NUMBER, "eta": NUMBER},
        ("roughness",),
        lambda fit: {"specular": fit["specular"] / math.pi, "roughness": fit["roughness"], "f0": fit["eta"]},
        raw=True,
        reflectance="eta",
    ),
    "ngan_ashikhminshirley": _Reading(
        NGAN,
        "NganAshikhminShirley",
        "ashikhmin_shirley",
        {"specular": COLOR, "sharpness": NUMBER, "fresnelReflectance": NUMBER},
        ("sharpness",),
        lambda fit: {"specular": fit["specular"], "exponent": fit["sharpness"], "f0": fit["fresnelReflectance"]},
        raw=True,
        reflectance="fresnelReflectance",
    ),
    # Only the ratio of its two factors matters.
    "ngan_lafortune": _Reading(
        NGAN,
        "NganLafortune",
        "lafortune",
        {"specular": COLOR, "Cxy": NUMBER, "Cz": NUMBER, "sharpness": NUMBER},
        ("Cz", "sharpness"),
        lambda fit: {"specular": fit["specular"], "cz": -fit["Cz"] / fit["Cxy"], "exponent": fit["sharpness"]},
        raw=True,
        negative=("Cxy",),
    ),
    # Where the index, which has three digits, is 1.00, nothing is reflected: that fit is lost.
    "ngan_he": _Reading(
        NGAN,
        "NganHe",
        "he",
        {"specular": COLOR, "autocorrelation": NUMBER, "roughness": NUMBER, "eta": NUMBER},
        ("autocorrelation", "roughness", "eta"),
        lambda fit: {
            "specular": fit["specular"],
            "roughness": fit["roughness"] / WAVELENGTH,
            "autocorrelation": fit["autocorrelation"] / WAVELENGTH,
            "ior": fit["eta"].clamp_min(1),
        },
        raw=True,
    ),
    "low_cooktorrance_E1": LOW_COOK_TORRANCE,
    "low_cooktorrance_E2": LOW_COOK_TORRANCE,
    "low_ashikhminshirley_E1": LOW_ASHIKHMIN_SHIRLEY,
    "low_ashikhminshirley_E2": LOW_ASHIKHMIN_SHIRLEY,
    "low_lowmicrofacet_E2": _Reading(
        LOW,
        "LowMicrofacetFit",
        "abc",
        {"A": COLOR, "B": NUMBER, "C": NUMBER, "eta": NUMBER},
        ("B", "C", "eta"),
        lambda fit: {"amplitude": fit["A"], "sharpness": fit["B"], "exponent": fit["C"], "ior": fit["eta"]},
    ),
    # Without the 1/pi of the microfacet model's.
    "low_lowsmooth_E2": _Reading(
        LOW,
        "LowSmooth",
        "abc_smooth",
        {"A": COLOR, "B": NUMBER, "C": NUMBER, "eta": NUMBER},
        ("B", "C", "eta"),
        lambda fit: {"amplitude": fit["A"], "sharpness": fit["B"], "exponent": fit["C"], "ior": fit["eta"]},
    ),
    "bagher_sgd": _Reading(
        BAGHER,
        "Bagher",
        "shifted_gamma",
        {"specular": COLOR, "alpha": COLOR, "p": COLOR, "eta": (2, 3), "K": COLOR}
        | {"Lambda": COLOR, "c": COLOR, "k": COLOR, "theta0": COLOR},
        ("alpha", "K", "Lambda", "c", "k"),
        _bagher,
    ),
}
"""How each set is read; the lobe is exactly the model that was fitted."""


@dataclass(frozen=True)
class PublishedFits:
    """Published fits of one set: a batched model, Lambert plus a lobe, in 1/sr, with a row for each of `materials`.

    The parameters are as published, also where they lie outside the bounds of our fits.
    """

    name: str
    source: str
    materials: list[str]
    model: Sum

    def __len__(self) -> int:
        return len(self.materials)

    def of(self, materials: Sequence[str]) -> Sum:
        """Batched model of some materials, in this order; a UsageError for one that the set lacks."""
        row = {name: k for k, name in enumerate(self.materials)}
        missing = [name for name in materials if name not in row]
        if missing:
            raise UsageError(f"{self.name}: expected one of its {len(self)} materials, found {missing[0]!r}")
        return with_parameters(
            self.model, take_materials(get_parameters(self.model), [row[name] for name in materials])
        )


def read_published(
    path: Path | str, *, dtype: torch.dtype | None = None, channel_scales: bool = True
) -> dict[str, PublishedFits]:
    """Read published fits: the sets of a file that `SETS` knows, by name; others in it are passed over.

    The models are in the units of MERL tables as `torchbrdf.measured.load` reads them. Ngan's fits are not: their green
    and blue lack the factors 1.15 and 1.66 of MERL's reader, and are multiplied by them. Nobody says so; it is seen
    from the ratio of the diffuse albedos of Low's Cook-Torrance fits (low_cooktorrance_E2) and Ngan's of the same
    materials, whose medians are 1.02, 1.17 and 1.70, while Low's and Bagher's agree; and the fits come closer to the
    tables so.

    Args:
        path: The JSON file.
        dtype: Of the models; by default torch's default dtype.
        channel_scales: Whether Ngan's fits are multiplied by these factors.

    Raises:
        DataError: The file is missing or holds something else; a field is missing, odd, or not finite.
    """
    path = Path(path)
    if not exists(path):
        raise DataError(f"{path}: no such file; expected {ORIGIN}")
    content: dict[str, Any] = read_json(path, dict[str, Any], ORIGIN)
    known = {name: content[name] for name in SETS if name in content}
    if not known:
        raise DataError(f"{path}: expected {ORIGIN}, found none of the sets {', '.join(SETS)}")
    return {name: _read_set(path, name, fits, dtype, channel_scales) for name, fits in known.items()}


def _read_set(path: Path, name: str, fits: Any, dtype: torch.dtype | None, channel_scales: bool) -> PublishedFits:
    if not isinstance(fits, dict) or not fits:
        raise DataError(f"{path}: {name}: expected fits by material, found {shown(fits)}")
    reading = SETS[name]
    fields = {"diffuse": COLOR} | reading.fields
    columns: dict[str, list[Tensor]] = {field: [] for field in fields}
    for material, fit in fits.items():
        where = f"{path}: {name}, {check_name(material, f'{path}: {name}')}"
        if not isinstance(fit, dict):
            raise DataError(f"{where}: expected the fields of a fit, found {shown(fit)}")
        if fit.get("model") != reading.model:
            raise DataError(f"{where}, model: expected {reading.model!r}, found {shown(fit.get('model'))}")
        for field, shape in fields.items():
            columns[field].append(_numbers(f"{where}, {field}", fit, field, shape, _bounds(reading, field)))
    stacked = {field: torch.stack(rows) for field, rows in columns.items()}
    diffuse, values = stacked["diffuse"], reading.parameters(stacked)
    if reading.raw and channel_scales:
        scale = diffuse.new_tensor(CHANNEL_FACTORS)
        diffuse, values["specular"] = diffuse * scale, values["specular"] * scale
    dtype = dtype or torch.get_default_dtype()
    for parameter, rows in {"albedo": diffuse, **values}.items():
        odd = (~rows.to(dtype).isfinite()).flatten(1).any(1).nonzero()
        if len(odd):
            material = list(fits)[int(odd[0])]
            raise DataError(f"{path}: {name}, {material}: expected numbers that make a finite {parameter}")
    model = Sum(Lambert(albedo=diffuse, dtype=dtype), LOBES[reading.lobe](dtype=dtype, **values))
    return PublishedFits(name, reading.source, list(fits), model)


def _bounds(reading: _Reading, field: str) -> tuple[float, float]:
    """What numbers of a field may be."""
    if field == reading.reflectance:
        return 0.0, 1.0
    if field in reading.negative:
        return -LARGEST, -SMALLEST
    least = SMALLEST if field in reading.positive else 0.0 if field in ALBEDOS else -LARGEST
    return least, LARGEST_C if field == "c" else LARGEST


def _numbers(
    where: str, fit: dict[str, Any], field: str, shape: tuple[int, ...], bounds: tuple[float, float]
) -> Tensor:
    """One field of a fit as a float64 tensor of this shape; a scalar in the file is `(1,)`."""
    if field not in fit:
        raise DataError(f"{where}: expected {_kind(shape)}, found no such field")
    found = fit[field]
    flat = [found] if shape == NUMBER else _flat(found, shape)
    if flat is None or not all(isinstance(x, int | float) and not isinstance(x, bool) for x in flat):
        raise DataError(f"{where}: expected {_kind(shape)}, found {shown(found)}")
    least, most = bounds
    if not all(least <= x <= most for x in flat):
        raise DataError(f"{where}: expected numbers from {least:g} to {most:g}, found {shown(found)}")
    return torch.tensor(flat, dtype=torch.float64, device="cpu").reshape(shape)


def _flat(found: Any, shape: tuple[int, ...]) -> list[Any] | None:
    """The entries of nested lists of this shape; None if they have another."""
    if not shape:
        return [found]
    if not isinstance(found, list) or len(found) != shape[0]:
        return None
    parts = [_flat(entry, shape[1:]) for entry in found]
    return None if None in parts else [x for part in parts if part is not None for x in part]


def _kind(shape: tuple[int, ...]) -> str:
    return "a number" if shape == NUMBER else " x ".join(map(str, shape)) + " numbers"
