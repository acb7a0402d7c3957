"""What people answered elsewhere about how alike materials look, and how well a loss predicts it."""

from typing import TYPE_CHECKING

from torchbrdf._lazy import exports

if TYPE_CHECKING:
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

_HOME = {
    "Appearance": "agreement.appearance",
    "compare_appearance": "agreement.appearance",
    "gloss_term": "agreement.appearance",
    "JodTable": "agreement.jod",
    "score_jod": "agreement.jod",
    "distances_of": "agreement.leaderboard",
    "score": "agreement.leaderboard",
    "FORMULAS": "agreement.metrics",
    "CallableMetric": "agreement.metrics",
    "as_metric": "agreement.metrics",
    "find_metric": "agreement.metrics",
    "metric_label": "agreement.metrics",
    "METHODS": "agreement.scores",
    "BenchmarkData": "agreement.scores",
    "EvaluatedBrdfs": "agreement.scores",
    "distances": "agreement.scores",
    "evaluate_brdfs": "agreement.scores",
    "score_opinions": "agreement.scores",
    "score_triplets": "agreement.scores",
    "Distances": "agreement.table",
    "Table": "agreement.table",
    "statistics_of": "agreement.table",
    "tabulate": "agreement.table",
    "read_benchmark_data": "datasets.benchmark_data",
    "FACTORS": "datasets.factors",
    "FactorFits": "datasets.factors",
    "FactorModel": "datasets.factors",
    "read_factors": "datasets.factors",
    "JodScores": "datasets.jod",
    "read_jod": "datasets.jod",
    "read_lagunas": "datasets.lagunas",
    "Opinions": "datasets.opinions",
    "read_opinions": "datasets.opinions",
    "PublishedFits": "datasets.published",
    "read_published": "datasets.published",
    "Ratings": "datasets.ratings",
    "read_ratings": "datasets.ratings",
    "Triplets": "datasets.triplets",
    "read_triplets": "datasets.triplets",
    "uniform_pairs": "directions",
    "Discrimination": "discrimination.psychometric",
    "Share": "discrimination.psychometric",
    "discrimination_of": "discrimination.psychometric",
    "told_apart": "discrimination.psychometric",
}
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

__getattr__, __dir__ = exports(__name__, _HOME)
