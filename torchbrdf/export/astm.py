"""ASTM E1392 text, as goniophotometers write it.

Source: ASTM E1392-96, Standard Practice for Angle Resolved Optical Scatter Measurements on Specular or Diffuse
Surfaces; and files of instruments that say so of themselves.
"""

from pathlib import Path

import numpy as np

from torchbrdf.export.base import EXPORTERS, Exported, Material
from torchbrdf.export.csv import rows_text
from torchbrdf.export.listing import listing
from torchbrdf.export.tables import TableExporter, copied
from torchbrdf.files import write_text
from torchbrdf.measured import Astm, Measured, load

ANGLES = ("theta_i", "phi_i", "theta_s", "phi_s")


@EXPORTERS.register("astm")
class AstmTable(TableExporter):
    """An `.astm`, a header and rows of four angles in radians and of values in 1/sr."""

    suffix = ".astm"
    own = Astm
    keeps_bands = True

    def write_file(self, material: Material, path: Path) -> Exported:
        """Write the table."""
        brdf = material.brdf
        if isinstance(brdf, Measured) and self.is_own(brdf):
            return copied(path, brdf)
        found = listing(brdf)
        text = rows_text(found.columns(("red", "green", "blue"), "brdf"), np.hstack([found.angles, found.values]))
        names, _, rows = text.partition("\n")
        head = {
            "SYSTEM_NAME": "torchbrdf",
            "SAMPLE_NAME": material.name,
            "NUM_POINTS": str(len(found.values)),
            **({"COMMENT": found.grain} if found.grain else {}),
            "VARS": ",".join([*ANGLES, names]),
        }
        write_text(path, "\n".join(f"{key} {value}" for key, value in head.items()) + f"\n{rows}")
        return Exported([path], found.is_own, [found.note], load(path))
