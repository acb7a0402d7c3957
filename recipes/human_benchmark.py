"""Losses scored against what people answered: how often each agrees with them."""

from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import TYPE_CHECKING

from torchbrdf.errors import UsageError
from torchbrdf.experiment.settings import ANGLES, HumanAnswersRecipe
from torchbrdf.kinds import DIFFERENCES, LOSSES, check_metric
from torchbrdf.reading import exists
from torchbrdf.recipe import RECIPES, RunFolder

if TYPE_CHECKING:
    from torchbrdf.pairs import Pairs
    from torchbrdf.perception import Appearance, BenchmarkData, JodTable


@RECIPES.register("human_benchmark")
@dataclass(frozen=True)
class HumanBenchmark(HumanAnswersRecipe):
    """Score every loss against human answers: triplets of materials, and opinions of approximations."""

    name = "human_benchmark"

    losses: tuple[str, ...] = field(
        default=(),
        metadata={
            "help": "losses to score, by name, module:name or file.py:name (which runs); none: all that are registered"
        },
    )
    images: bool = field(default=False, metadata={"help": "also score pictures of a sphere"})
    differences: tuple[str, ...] = field(default=("delta_e76",), metadata={"help": "image differences of the pictures"})
    size: int = field(default=64, metadata={"help": "pixels of a side of the pictures", "low": 16, "high": 512})
    max_theta: float = field(
        default=80.0, metadata={"help": "only pairs with both directions below this angle", **ANGLES}
    )

    ratings: str = field(
        default="serrano2016_mean_ratings.csv",
        metadata={"help": "how glossy and so on people find the materials, a file in `human`; none: left out"},
    )
    jod: str = field(
        default="kavoosighafi2025_jod_train.csv",
        metadata={"help": "JOD scores of approximations, a file in `human`; none: left out"},
    )
    jod_tables: str = field(
        default="", metadata={"help": "a folder with the tables of these approximations, such as aluminium_1.binary"}
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in self.losses:
            check_metric(name)
        for name in self.differences:
            DIFFERENCES.check(name)
        if not self.quick:
            for key in ("materials", "human"):
                if not getattr(self, key):
                    raise UsageError(f"{self.name}: {key}: expected a folder; quick=true runs on made-up answers")

    def steps(self, folder: RunFolder) -> Path:
        """Distances of every loss, statistics, report."""
        from torchbrdf.experiment.benchmark import LAGUNAS, Benchmark, write_scores
        from torchbrdf.experiment.discrimination import calibrate_metrics
        from torchbrdf.experiment.metric_training import PUBLISHED
        from torchbrdf.perception import statistics_of, tabulate, uniform_pairs
        from torchbrdf.perception.datasets.synthetic import SYNTHETIC, synthetic_benchmark
        from torchbrdf.render import Camera, Environment, Scene, sphere
        from torchbrdf.report import HumanPage, write_human_report

        samples, replicates, size = self.samples, self.replicates, self.size
        if self.quick:
            samples, replicates, size = 500, min(replicates, 200), min(size, 24)
        data = synthetic_benchmark(seed=self.seed) if self.quick else self.read_benchmark_data()
        pairs = uniform_pairs(samples, self.max_theta, self.seed)
        appearance, jod = (None, None) if self.quick else self.read_others(data, pairs, replicates)
        benchmark = Benchmark(folder, data)
        benchmark.score_values(self._metrics(), pairs)
        if self.images:
            scene = Scene(sphere(), Camera(), Environment.default(), size=size, cache=folder.path / "cache")
            benchmark.score_pictures(self.differences, scene)
        if not self.quick:
            benchmark.add_published(Path(self.human) / LAGUNAS)
        if not benchmark.distances:
            raise UsageError(f"{self.name}: no loss could be scored")
        statistics = statistics_of(data.triplets, data.opinions)
        table = tabulate(statistics, benchmark.distances, replicates, self.seed)
        write_scores(folder.path, table)
        facts = {
            "answers": SYNTHETIC if self.quick else PUBLISHED,
            "tables": "stand-ins for measured tables" if data.stand_in else "measured",
            "values": f"at {samples} pairs",
            "pictures": f"of a sphere in the bundled light, {size} x {size} pixels" if self.images else "none",
        }
        calibrated = calibrate_metrics(folder, data, benchmark.distances, facts, replicates, self.seed)
        said = HumanPage(
            synthetic=self.quick,
            stand_in=data.stand_in,
            images=self.images,
            left_out=benchmark.left_out,
            pairs=len(pairs),
            max_theta=self.max_theta,
            replicates=replicates,
            appearance=appearance,
            jod=jod,
        )
        return write_human_report(folder.path, table, data, said, calibrated)

    def read_others(
        self, data: "BenchmarkData", pairs: "Pairs", replicates: int
    ) -> "tuple[Appearance | None, JodTable | None]":
        """What other studies asked, where there are their answers: ratings, and JOD scores."""
        from torchbrdf.measured import MERL_NAMES, load
        from torchbrdf.perception import compare_appearance, metric_label, read_jod, read_ratings, score_jod

        human, appearance, jod = Path(self.human), None, None
        if self._wanted("ratings"):
            ratings = read_ratings(human / self.ratings, MERL_NAMES)
            appearance = compare_appearance(data.measured, ratings, replicates, self.seed, pairs)
        if self._wanted("jod"):
            scores = read_jod(human / self.jod)
            metrics, tables = (self._metrics(), load(self.jod_tables)) if self.jod_tables else ((), None)
            jod = score_jod(
                scores,
                {metric_label(text): text for text in metrics} or None,
                tables,
                data.measured,
                pairs=pairs,
                replicates=replicates,
                seed=self.seed,
            )
        return appearance, jod

    def _metrics(self) -> tuple[str, ...]:
        from torchbrdf.perception import FORMULAS

        return self.losses or (*LOSSES, *FORMULAS)

    def _wanted(self, key: str) -> bool:
        """Whether to read a file: it is there, or was asked for by another name than the default."""
        name = getattr(self, key)
        default = next(one.default for one in fields(self) if one.name == key)
        return name.lower() not in ("", "none") and (name != default or exists(Path(self.human) / name))
