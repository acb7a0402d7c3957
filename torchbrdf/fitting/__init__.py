"""Fitting models to measured materials: objectives, strategies, scores, results."""

from torchbrdf.fitting.api import SlowFitWarning, fit
from torchbrdf.fitting.batches import Batches
from torchbrdf.fitting.global_search import GlobalSearch
from torchbrdf.fitting.image_driven import ImageDriven
from torchbrdf.fitting.result import FitResult, write_fits_csv
from torchbrdf.fitting.sampling import stratified
from torchbrdf.fitting.scoring import cross_score, local_minima, score
from torchbrdf.fitting.strategy import STRATEGIES
from torchbrdf.fitting.sufficient_statistics import Gathered
from torchbrdf.fitting.tabulated import TabulatedFit
from torchbrdf.solvers import Status

__all__ = [
    "STRATEGIES",
    "Batches",
    "FitResult",
    "Gathered",
    "GlobalSearch",
    "ImageDriven",
    "SlowFitWarning",
    "Status",
    "TabulatedFit",
    "cross_score",
    "fit",
    "local_minima",
    "score",
    "stratified",
    "write_fits_csv",
]
