"""What people answered elsewhere about how alike materials look, and how well a loss predicts it."""

from torchbrdf.perception.agreement.scores import (
    METHODS,
    BenchmarkData,
    EvaluatedBrdfs,
    distances,
    evaluate_brdfs,
    score_opinions,
    score_triplets,
)
from torchbrdf.perception.agreement.table import Distances, Table, statistics_of, tabulate
from torchbrdf.perception.datasets.benchmark_data import read_benchmark_data
from torchbrdf.perception.datasets.factors import FACTORS, FactorFits, FactorModel, read_factors
from torchbrdf.perception.datasets.lagunas import read_lagunas
from torchbrdf.perception.datasets.opinions import Opinions, read_opinions
from torchbrdf.perception.datasets.published import PublishedFits, read_published
from torchbrdf.perception.datasets.triplets import Triplets, read_triplets
from torchbrdf.perception.directions import uniform_pairs
from torchbrdf.perception.discrimination.psychometric import Discrimination, Share, discrimination_of, told_apart

__all__ = [
    "FACTORS",
    "METHODS",
    "BenchmarkData",
    "Discrimination",
    "Distances",
    "EvaluatedBrdfs",
    "FactorFits",
    "FactorModel",
    "Opinions",
    "PublishedFits",
    "Share",
    "Table",
    "Triplets",
    "discrimination_of",
    "distances",
    "evaluate_brdfs",
    "read_benchmark_data",
    "read_factors",
    "read_lagunas",
    "read_opinions",
    "read_published",
    "read_triplets",
    "score_opinions",
    "score_triplets",
    "statistics_of",
    "tabulate",
    "told_apart",
    "uniform_pairs",
]
