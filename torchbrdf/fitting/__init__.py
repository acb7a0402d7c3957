"""Fitting models to measured materials: objectives, strategies, scores, results."""

from typing import TYPE_CHECKING

from torchbrdf._lazy import exports
from torchbrdf.solvers import Status

if TYPE_CHECKING:
    from torchbrdf.fitting.api import SlowFitWarning, fit
    from torchbrdf.fitting.batches import Batches
    from torchbrdf.fitting.collecting import Collected, collect
    from torchbrdf.fitting.determined import undetermined
    from torchbrdf.fitting.gathered import Gathered
    from torchbrdf.fitting.global_search import GlobalSearch
    from torchbrdf.fitting.image_driven import ImageDriven
    from torchbrdf.fitting.result import FitResult, write_fits_csv
    from torchbrdf.fitting.sampling import stratified
    from torchbrdf.fitting.scoring import cross_score, local_minima, score
    from torchbrdf.fitting.strategy import STRATEGIES
    from torchbrdf.fitting.tabulated import TabulatedFit

_HOME = {
    "SlowFitWarning": "api",
    "fit": "api",
    "Batches": "batches",
    "Collected": "collecting",
    "collect": "collecting",
    "undetermined": "determined",
    "GlobalSearch": "global_search",
    "ImageDriven": "image_driven",
    "FitResult": "result",
    "write_fits_csv": "result",
    "stratified": "sampling",
    "cross_score": "scoring",
    "local_minima": "scoring",
    "score": "scoring",
    "STRATEGIES": "strategy",
    "Gathered": "gathered",
    "TabulatedFit": "tabulated",
}
__all__ = [
    "STRATEGIES",
    "Batches",
    "Collected",
    "FitResult",
    "Gathered",
    "GlobalSearch",
    "ImageDriven",
    "SlowFitWarning",
    "Status",
    "TabulatedFit",
    "collect",
    "cross_score",
    "fit",
    "local_minima",
    "score",
    "stratified",
    "undetermined",
    "write_fits_csv",
]

__getattr__, __dir__ = exports(__name__, _HOME)
