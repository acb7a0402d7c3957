"""What people answered elsewhere about how alike materials look, and how well a loss predicts it."""

from torchbrdf.human.directions import uniform_pairs
from torchbrdf.human.factors import FACTORS, FactorFits, FactorModel, read_factors
from torchbrdf.human.lagunas import read_lagunas
from torchbrdf.human.opinions import Opinions, read_opinions
from torchbrdf.human.published import PublishedFits, read_published
from torchbrdf.human.scores import METHODS, Seen, Subjects, distances, gather, score_opinions, score_triplets
from torchbrdf.human.subjects import read_subjects
from torchbrdf.human.table import Distances, Table, statistics_of, tabulate
from torchbrdf.human.triplets import Triplets, read_triplets

__all__ = [
    "FACTORS",
    "METHODS",
    "Distances",
    "FactorFits",
    "FactorModel",
    "Opinions",
    "PublishedFits",
    "Seen",
    "Subjects",
    "Table",
    "Triplets",
    "distances",
    "gather",
    "read_factors",
    "read_lagunas",
    "read_opinions",
    "read_published",
    "read_subjects",
    "read_triplets",
    "score_opinions",
    "score_triplets",
    "statistics_of",
    "tabulate",
    "uniform_pairs",
]
