"""What people answered elsewhere about how alike materials look, and how well a loss predicts it."""

from torchbrdf.perception.agreement.appearance import Appearance, compare_appearance, gloss_term
from torchbrdf.perception.agreement.jod import JodTable, score_jod
from torchbrdf.perception.agreement.leaderboard import distances_of, score
from torchbrdf.perception.agreement.metrics import FORMULAS, CallableMetric, as_metric, find_metric, metric_label
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
from torchbrdf.perception.datasets.jod import JodScores, read_jod
from torchbrdf.perception.datasets.lagunas import read_lagunas
from torchbrdf.perception.datasets.opinions import Opinions, read_opinions
from torchbrdf.perception.datasets.published import PublishedFits, read_published
from torchbrdf.perception.datasets.ratings import Ratings, read_ratings
from torchbrdf.perception.datasets.triplets import Triplets, read_triplets
from torchbrdf.perception.directions import uniform_pairs
from torchbrdf.perception.discrimination.psychometric import Discrimination, Share, discrimination_of, told_apart

__all__ = [
    "FACTORS",
    "FORMULAS",
    "METHODS",
    "Appearance",
    "BenchmarkData",
    "CallableMetric",
    "Discrimination",
    "Distances",
    "EvaluatedBrdfs",
    "FactorFits",
    "FactorModel",
    "JodScores",
    "JodTable",
    "Opinions",
    "PublishedFits",
    "Ratings",
    "Share",
    "Table",
    "Triplets",
    "as_metric",
    "compare_appearance",
    "discrimination_of",
    "distances",
    "distances_of",
    "evaluate_brdfs",
    "find_metric",
    "gloss_term",
    "metric_label",
    "read_benchmark_data",
    "read_factors",
    "read_jod",
    "read_lagunas",
    "read_opinions",
    "read_published",
    "read_ratings",
    "read_triplets",
    "score",
    "score_jod",
    "score_opinions",
    "score_triplets",
    "statistics_of",
    "tabulate",
    "told_apart",
    "uniform_pairs",
]
