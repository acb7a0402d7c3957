"""Answers of nobody, to see that all works without the data."""

from collections.abc import Sequence
from dataclasses import dataclass

import torch

from torchbrdf.lobes import Lambert, Lobe, Sum, Ward
from torchbrdf.measured import load, standins
from torchbrdf.perception.agreement.scores import BenchmarkData
from torchbrdf.perception.datasets.opinions import Opinions
from torchbrdf.perception.datasets.triplets import Triplets
from torchbrdf.perception.directions import uniform_pairs

SYNTHETIC = "made-up answers: nobody was asked"
"""What has to be said wherever they are shown."""


@dataclass(frozen=True)
class Guess:
    """Guess at materials: each as its diffuse colour and one lobe of Ward's, all with one roughness."""

    materials: list[str]
    diffuse: torch.Tensor
    roughness: float

    def of(self, materials: Sequence[str]) -> Lobe:
        """Batched model of some materials."""
        rows = [self.materials.index(name) for name in materials]
        lobe = Ward(
            specular=torch.full((len(rows), 3), 0.1, dtype=torch.float32, device="cpu"),
            roughness=torch.full((len(rows), 1), self.roughness, dtype=torch.float32, device="cpu"),
        )
        return Sum(Lambert(albedo=self.diffuse[rows]), lobe)


def synthetic_benchmark(questions: int = 300, seed: int = 0) -> BenchmarkData:
    """Synthetic data of the benchmark: the bundled stand-ins, three guesses at each, and made-up answers.

    Answers are drawn around differences of cube roots.

    Nobody was asked: such answers only show that all works.
    """
    generator = torch.Generator("cpu").manual_seed(seed)
    measured = load(standins(), dtype=torch.float64)
    names, pairs = sorted(measured.names), uniform_pairs(500, seed=seed)
    measured = measured.batch([measured.names.index(name) for name in names])
    diffuse = measured.diffuse_45_0().float()
    guesses = {f"GUESS-{k}": Guess(names, diffuse, rough) for k, rough in enumerate((0.05, 0.15, 0.4), 1)}
    values = measured.at(pairs).clamp_min(0).pow(1 / 3)

    order = torch.rand(questions, len(names), generator=generator, dtype=torch.float32, device="cpu").argsort(1)[:, :3]
    away = [(values[order[:, k]] - values[order[:, 0]]).abs().mean((1, 2)) for k in (1, 2)]
    chance = torch.special.ndtr((away[1] - away[0]) / 0.1)
    first = (torch.rand(questions, 5, generator=generator, dtype=torch.float64, device="cpu") < chance[:, None]).sum(1)
    triplets = Triplets(names, order, torch.stack([first, 5 - first], 1))

    methods = [method for method in guesses for _ in names]
    with torch.no_grad():
        shown = torch.cat([guess.of(names).to(dtype=torch.float64)(pairs) for guess in guesses.values()])
    error = (shown.clamp_min(0).pow(1 / 3) - values.repeat(len(guesses), 1, 1)).abs().mean((1, 2))
    noise = 0.03 * torch.randn(len(error), generator=generator, dtype=torch.float64, device="cpu")
    return BenchmarkData(
        measured, triplets, Opinions(methods, names * len(guesses), (error / error.max() + noise).clamp(0, 1)), guesses
    )
