"""What exporters of tables have in common."""

import shutil
from abc import abstractmethod
from dataclasses import replace
from pathlib import Path
from typing import ClassVar

from torchbrdf.errors import DataError
from torchbrdf.export.bands import in_rgb
from torchbrdf.export.base import Brdf, Exported, Exporter, Material
from torchbrdf.files import replacing
from torchbrdf.measured import BrdfFormat, Measured, StandIn
from torchbrdf.measured.azimuths import TURNS, without_grain
from torchbrdf.measured.bands import DEFAULT_ILLUMINANT, bands_in_words, colors_label
from torchbrdf.measured.tables import measured_up_to

NEARLY_ALL = 85.0
"""Degrees from the normal up to which data say enough for every picture."""
_NO_BANDS = "bands are not kept: the format holds linear RGB only"
# What a reader may be told that changes nothing of what a copy of the file says.
_HARMLESS = ("bands", "illuminant")


class TableExporter(Exporter):
    """Base of those that write what a measurement is, values at directions: files that `torchbrdf.load` reads again.

    Attributes:
        own: The format of the files, of which one is copied.
    """

    own: ClassVar[type[BrdfFormat] | None] = None

    def write(self, material: Material, folder: Path) -> Exported:
        """Write the table."""
        return self.write_file(material, material.path(folder, self.suffix))

    @abstractmethod
    def write_file(self, material: Material, path: Path) -> Exported:
        """Write a material as one file, whole or not at all.

        Args:
            material: As of `write`; one that `suited` made.
            path: Of the file.
        """

    def is_own(self, brdf: Brdf) -> bool:
        """Whether a material is a file of the format, which says the same when it is copied."""
        return (
            self.own is not None
            and isinstance(brdf, Measured)
            and isinstance(brdf.source, self.own)
            and set(brdf.source.told) <= set(_HARMLESS)
        )

    def suited(self, material: Material) -> Material:
        """A material as the format can hold it, with notes on what it cannot.

        Args:
            material: With bands or without, with a grain or without.

        Raises:
            DataError: It has bands of which nobody knows the wavelengths, which no format of tables holds.
        """
        if self.is_own(material.brdf):
            return material
        if isinstance(material.brdf, Measured) and not material.brdf.is_rgb:
            material = self._in_bands(material, material.brdf)
        if self.no_grain and material.brdf.is_anisotropic:
            note = f"the grain is left out: an isotropic table, of the mean over {TURNS} azimuths of the surface"
            material = replace(
                material, brdf=without_grain(material.brdf, material.name), notes=(*material.notes, note)
            )
        return material

    def _in_bands(self, material: Material, brdf: Measured) -> Material:
        """A material whose bands the format holds, or as linear RGB."""
        found = bands_in_words(brdf.channels, brdf.wavelengths)
        if brdf.wavelengths is None and brdf.channels > 1:
            where = ": ".join([*map(str, material.files[:1]), material.name])
            raise DataError(
                f"{where}: expected linear RGB, one band, or bands whose wavelengths are known, found {found}; tables "
                "have no others: give wavelengths with the samples (columns 465nm, ...) or in fits.json"
            )
        if self.keeps_bands:
            return material
        illuminant = brdf.source.told.get("illuminant", DEFAULT_ILLUMINANT)
        if isinstance(brdf.source, StandIn):
            model, notes = in_rgb(brdf.source.records[brdf.materials[0]], illuminant)
        else:
            model = brdf.to_rgb(illuminant)
            notes = [f"colours: {colors_label(brdf.wavelengths or [0.0], illuminant)}, of {found}"]
        return replace(material, brdf=model, notes=(*material.notes, _NO_BANDS, *notes))


def copied(path: Path, measured: Measured) -> Exported:
    """A measurement's own file as it is."""
    with replacing(path) as part:
        shutil.copyfile(measured.source.paths[measured.materials[0]], part)
    return Exported([path], True, ["exact: the measurement's own file"], measured)


def reach(brdf: Brdf) -> list[str]:
    """A note on what was not measured, if that is a part of pictures."""
    found = measured_up_to(brdf)
    return [] if found.both >= NEARLY_ALL else [f"measured {found.words('up to')}; beyond, values are extrapolated"]
