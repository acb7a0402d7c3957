"""What an exporter is: it writes one material for one program, and says what that program will show."""

import importlib
from abc import ABC, abstractmethod
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import ClassVar

import numpy as np
import torch
from torch import Tensor

from torchbrdf import kinds
from torchbrdf.errors import DataError, UsageError
from torchbrdf.lobes import Lobe
from torchbrdf.measured import Measured
from torchbrdf.names import check_name, file_stem
from torchbrdf.registry import Registry
from torchbrdf.render import Mesh

EXPORTERS: Registry[type["Exporter"]] = kinds.EXPORTERS

Brdf = Lobe | Measured


@dataclass(frozen=True)
class Material:
    """What is exported.

    Args:
        name: Of the material.
        brdf: A lobe or a sum of them, not batched, with parameters within their bounds; or one measured material.
        notes: What was made of it before, one line each.
        files: That it was read from.

    Raises:
        DataError: The name is none.

    Example:
        >>> from torchbrdf.export import Material
        >>> from torchbrdf.lobes import Lambert
        >>> Material("chalk", Lambert(albedo=0.8)).path("out", ".xml").as_posix()
        'out/chalk.xml'
    """

    name: str
    brdf: Brdf
    notes: tuple[str, ...] = ()
    files: tuple[Path, ...] = ()

    def __post_init__(self) -> None:
        check_name(self.name, "export: name")

    def path(self, folder: Path | str, suffix: str) -> Path:
        """The file of the material in a folder, whose name every system allows."""
        return Path(folder) / f"{file_stem(self.name)}{suffix}"


@dataclass(frozen=True)
class Exported:
    """What was written, and what will be seen of it.

    Args:
        files: The files; the first is the one to open.
        exact: Whether the program shows the same BRDF: the same function with the same parameters.
        notes: What is exact, what was refitted and what was written as a table, one line each.
        shown: The BRDF that the program will show; the material's own where that is exact.
    """

    files: list[Path]
    exact: bool
    notes: list[str]
    shown: Brdf


class Exporter(ABC):
    """Base of what writes materials for a program. An exporter is a registered subclass, in a file of its own.

    Args:
        mesh: The object that is to wear the material, of exporters that write one.

    Raises:
        UsageError: A mesh is given to an exporter that writes none.

    Attributes:
        suffix: Of the file to open, such as ".xml".
        beside: Suffixes of other files that it may write, such as ".bsdf".
        writes_mesh: Whether an object is written, too.
        no_grain: Why there is no room for a grain, "" where there is: lobes with one are refused, or, in tables, their
            means over all azimuths are written.
        keeps_bands: Whether bands of wavelengths are written as they are; others write linear RGB.
    """

    suffix: ClassVar[str]
    beside: ClassVar[tuple[str, ...]] = ()
    writes_mesh: ClassVar[bool] = False
    no_grain: ClassVar[str] = ""
    keeps_bands: ClassVar[bool] = False

    def __init__(self, mesh: Mesh | None = None) -> None:
        if mesh is not None and not self.writes_mesh:
            name = EXPORTERS.name_of(type(self)) or type(self).__name__
            raise UsageError(f"mesh: expected none, since {name} writes materials only, found {mesh.name}")
        self.mesh = mesh

    @abstractmethod
    def write(self, material: Material, folder: Path) -> Exported:
        """Write a material, each file whole or not at all, the one to open last.

        Args:
            material: What to write; it is neither changed nor kept.
            folder: Where; it is there and can be written. The file to open is `material.path(folder, suffix)`.

        Returns:
            What was written.

        Raises:
            TorchbrdfError: The program cannot show such a material, in one line that says why.
        """


def has_grain(material: Material) -> bool:
    """Whether a material is a model with a grain."""
    return isinstance(material.brdf, Lobe) and material.brdf.is_anisotropic


def refuse_grain(material: Material, to: str, lacks: str) -> None:
    """Refuse a lobe with a grain.

    Args:
        material: What is exported.
        to: The exporter's name.
        lacks: What it has no place for a grain in, in a few words.

    Raises:
        DataError: The material is a lobe with a grain.
    """
    if has_grain(material):
        raise DataError(f"{material.name}: expected an isotropic material for {to}, found one with a grain: {lacks}")


def numbers(value: Tensor) -> list[float]:
    """The numbers of a parameter, with as many digits as single precision has, which is what renderers have.

    Example:
        >>> import torch
        >>> from torchbrdf.export.base import numbers
        >>> torch.tensor([0.3]).tolist(), numbers(torch.tensor([0.3]))
        ([0.30000001192092896], [0.3])
    """
    # No str: libraries change how NumPy prints numbers, down to six digits.
    single = value.detach().flatten().to(torch.float32).cpu().numpy()
    return [float(np.format_float_scientific(number, unique=True)) for number in single]


def needed(package: str, extra: str, purpose: str) -> ModuleType:
    """Import a package that is not always there.

    Args:
        package: Its name in Python.
        extra: What has to be installed, as in `pip install torchbrdf[extra]`.
        purpose: What it is needed for.

    Raises:
        UsageError: It is not installed.

    Example:
        >>> from torchbrdf.export.base import needed
        >>> needed("json", "web", "to write JSON").__name__
        'json'
    """
    try:
        return importlib.import_module(package)
    except ImportError as error:
        raise UsageError(
            f"{purpose}: expected the package {package}, found none ({error}); pip install 'torchbrdf[{extra}]'"
        ) from None
