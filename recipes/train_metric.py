"""Learn a readable BRDF metric from what people answered, and judge it on materials that it never saw."""

from dataclasses import dataclass, field
from pathlib import Path

from torchbrdf.errors import UsageError
from torchbrdf.experiment.settings import HumanAnswersRecipe
from torchbrdf.files import write_json
from torchbrdf.recipe import RECIPES, RunFolder

HELD_OUT = ("materials", "materials_and_method", "materials_and_two_methods")


@RECIPES.register("train_metric")
@dataclass(frozen=True)
class TrainMetric(HumanAnswersRecipe):
    """Learn the constants of LearnedLoss from published answers, from one's own study, or both."""

    name = "train_metric"

    leave_out: tuple[str, ...] = field(
        default=("ABC",), metadata={"help": "methods whose parameters are not what people saw"}
    )
    study: str = field(
        default="", metadata={"help": "the folder of a run of fores2012 that observers were asked about"}
    )
    answers: str = field(default="", metadata={"help": "the answers, a CSV file: torchbrdf study export"})
    repeats: int = field(
        default=10, metadata={"help": "of the two-fold cross-validation over materials", "low": 1, "high": 1000}
    )
    bins: float = field(
        default=0.15,
        metadata={
            "help": "the share of bins in the mean distance of two materials, set and not learned",
            "low": 0.05,
            "high": 0.45,
        },
    )
    pointwise: float = field(
        default=0.2, metadata={"help": "that of single values, set and not learned", "low": 0.05, "high": 0.45}
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if bool(self.study) != bool(self.answers):
            raise UsageError(f"{self.name}: expected a study and its answers, found only one of them")
        if not self.quick and not self.study and not self.human:
            raise UsageError(f"{self.name}: expected human, or study and answers; quick=true runs on made-up answers")
        if self.human and not self.materials:
            raise UsageError(f"{self.name}: materials: expected a folder with the MERL tables")

    def steps(self, folder: RunFolder) -> Path:
        """Terms of all distances, trainings on halves, one on everything, and what they are worth."""
        import torch

        from torchbrdf.experiment.metric_training import join_data, published_data, study_data, train_metric
        from torchbrdf.losses import LOSSES, make_loss
        from torchbrdf.perception import uniform_pairs
        from torchbrdf.perception.datasets.synthetic import synthetic_benchmark
        from torchbrdf.report import write_metric_report

        samples, repeats, replicates = self.samples, self.repeats, self.replicates
        if self.quick:
            samples, repeats, replicates = 500, 2, min(replicates, 20)
        pairs = uniform_pairs(samples, seed=self.seed).to(dtype=torch.float32)
        losses = {
            name: loss
            for name, loss in ((name, make_loss(name, "none")) for name in LOSSES)
            if loss.supports_subsampling and name != "learned"
        }
        sources = []
        if self.human or (self.quick and not self.study):
            benchmark_data = self.read_benchmark_data() if self.human else synthetic_benchmark(seed=self.seed)
            sources.append(published_data(benchmark_data, pairs, losses, self.leave_out, synthetic=not self.human))
        if self.study:
            sources.append(study_data(Path(self.study), Path(self.answers), pairs, losses))
        data = join_data(sources)
        trained = train_metric(
            data,
            folder,
            repeats=repeats,
            replicates=replicates,
            given={"bins": self.bins, "pointwise": self.pointwise},
            samples=samples,
            seed=self.seed,
        )
        write_json(folder.path / "metric.json", trained.metric)
        kept = {name: trained.held_out[k] for k, name in enumerate(HELD_OUT) if k in trained.held_out}
        write_json(folder.path / "held_out.json", kept)
        return write_metric_report(folder.path, trained, data.mark)
