"""Scales from paired comparisons, with intervals, tests, and reports on observers."""

from torchbrdf.study.scaling.comparisons import Comparisons
from torchbrdf.study.scaling.intervals import Method, bootstrap, montag
from torchbrdf.study.scaling.kendall import Agreement, agreement, circular_triads, consistence
from torchbrdf.study.scaling.likelihood_ratio import Goodness, goodness
from torchbrdf.study.scaling.observers import ObserverReport, agreement_with_others, observer_reports
from torchbrdf.study.scaling.power import observers_needed, power_of
from torchbrdf.study.scaling.scales import Scales, scale
from torchbrdf.study.scaling.simulate import simulated_wins
from torchbrdf.study.scaling.thurstone import PRIOR, least_squares, most_likely

__all__ = [
    "PRIOR",
    "Agreement",
    "Comparisons",
    "Goodness",
    "Method",
    "ObserverReport",
    "Scales",
    "agreement",
    "agreement_with_others",
    "bootstrap",
    "circular_triads",
    "consistence",
    "goodness",
    "least_squares",
    "montag",
    "most_likely",
    "observer_reports",
    "observers_needed",
    "power_of",
    "scale",
    "simulated_wins",
]
