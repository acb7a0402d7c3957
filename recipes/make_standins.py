"""Stand-ins such as the bundled ones: the paper's "hybrid" form, fitted to MERL-format tables."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from torchbrdf.experiment.rounding import rounded
from torchbrdf.experiment.settings import FIT_SAMPLES
from torchbrdf.recipe import RECIPES, Recipe, RunFolder

if TYPE_CHECKING:
    from torchbrdf.lobes import FitRecord


@RECIPES.register("make_standins")
@dataclass(frozen=True)
class MakeStandins(Recipe):
    """Fit a diffuse term and a tabulated microfacet distribution to tables, and write them as one fits.json.

    The bundled ones were made with the same form by another solver, with Schlick's Fresnel alone.
    """

    name = "make_standins"

    materials: str = field(
        default="", metadata={"help": "MERL-format tables; without it the bundled ones are refitted"}
    )
    samples: int = field(default=40_000, metadata={"help": "pairs that the solver sees", **FIT_SAMPLES})
    digits: int = field(default=4, metadata={"help": "significant digits kept", "low": 2, "high": 17})

    def steps(self, folder: RunFolder) -> Path:
        """Fit under the cube-root-compressed loss, so that the lobe's flanks count beside its peak."""
        from torchbrdf.fitting import fit
        from torchbrdf.lobes import make_model, write_fits
        from torchbrdf.losses import CompressedLoss
        from torchbrdf.measured import load, standins

        measured = load(self.materials or standins())
        samples = self.samples
        if self.quick:
            measured, samples = measured.batch(range(min(2, len(measured)))), 4000
        result = fit(
            make_model("distribution_based", 1),
            measured,
            CompressedLoss(),
            samples=samples,
            seed=self.seed,
            progress=folder.progress("stand-ins"),
        )
        for name, error, status in zip(result.names, result.error.tolist(), result.status, strict=True):
            folder.log(f"{name}: compressed error {error:.4g}, {status}")
        path = folder.path / "standins.json"
        write_fits(path, [self._without_settings(record) for record in result.records()])
        return path

    def _without_settings(self, record: "FitRecord") -> "FitRecord":
        """What is needed of a fit that stands in for a material, in few digits."""
        from torchbrdf.lobes import FitRecord

        return FitRecord(
            record.material,
            record.model,
            record.lobes,
            rounded(record.parameters, self.digits),
            loss=record.loss,
            error=rounded(record.error, self.digits),
            status=record.status,
        )
