"""How the bundled stand-ins were made: the paper's "hybrid" form, fitted to MERL-format tables."""

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import torch

from torchbrdf.experiment.settings import FIT_SAMPLES
from torchbrdf.fitting import fit
from torchbrdf.lobes import DistributionBased, FitRecord, Lambert, Sum, write_fits
from torchbrdf.lobes.distribution_based import NODES
from torchbrdf.losses import CompressedLoss
from torchbrdf.measured import Measured, load, standins
from torchbrdf.pairs import Pairs
from torchbrdf.recipe import RECIPES, Recipe, RunFolder


@RECIPES.register("make_standins")
@dataclass(frozen=True)
class MakeStandins(Recipe):
    """Fit a diffuse term and a tabulated microfacet distribution to tables, and write them as one fits.json."""

    name = "make_standins"

    materials: str = field(
        default="", metadata={"help": "MERL-format tables; without it the bundled ones are refitted"}
    )
    samples: int = field(default=40_000, metadata={"help": "pairs that the solver sees", **FIT_SAMPLES})
    digits: int = field(default=4, metadata={"help": "significant digits kept", "low": 2, "high": 17})

    def steps(self, folder: RunFolder) -> Path:
        """Fit under the cube-root-compressed loss, so that the lobe's flanks count beside its peak."""
        measured = load(self.materials or standins())
        samples = self.samples
        if self.quick:
            measured, samples = measured.batch(range(min(2, len(measured)))), 4000
        model = Sum(Lambert(albedo=measured.diffuse_45_0()), DistributionBased(distribution=first_guess(measured)))
        result = fit(
            model,
            measured,
            CompressedLoss(),
            strategy="staged",
            diffuse="fit",
            samples=samples,
            seed=self.seed,
            max_iterations=100 if self.quick else 400,
            progress=folder.progress("stand-ins"),
        )
        for name, error, status in zip(result.names, result.error.tolist(), result.status, strict=True):
            folder.log(f"{name}: compressed error {error:.4g}, {status}")
        path = folder.path / "standins.json"
        write_fits(path, [self._without_settings(record) for record in result.records()])
        return path

    def _without_settings(self, record: FitRecord) -> FitRecord:
        """What is needed of a fit that stands in for a material, in few digits."""
        return FitRecord(
            record.material,
            record.model,
            record.lobes,
            self._rounded(record.parameters),
            loss=record.loss,
            error=self._rounded(record.error),
            status=record.status,
        )

    def _rounded(self, value: Any) -> Any:
        if isinstance(value, float):
            return float(f"{value:.{self.digits}g}")
        if isinstance(value, list):
            return [self._rounded(item) for item in value]
        if isinstance(value, dict):
            return {key: self._rounded(item) for key, item in value.items()}
        return value


def first_guess(measured: Measured) -> torch.Tensor:
    """A distribution read off at theta_d = 20, phi_d = 90 degrees, where both directions stay low, `(M, K, 3)`."""
    theta_h = ((torch.arange(NODES, dtype=torch.float64) + 0.5) / NODES).square()[None] * (math.pi / 2)
    theta_d = torch.full_like(theta_h, math.radians(20))
    pairs = Pairs.from_half_diff(theta_h, theta_d, torch.full_like(theta_h, math.pi / 2))
    excess = measured.at(pairs) - measured.diffuse_45_0()[:, None] / math.pi
    return (excess * (10 * pairs.cos_i * pairs.cos_o)[..., None]).clamp_min(1e-3).float()
