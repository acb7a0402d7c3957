"""Scales from paired comparisons, with intervals, tests, and reports on observers."""

from torchbrdf.psychophysics.comparisons import Comparisons
from torchbrdf.psychophysics.intervals import Method, bootstrap, montag
from torchbrdf.psychophysics.kendall import KendallAgreement, circular_triads, consistence, kendall_agreement
from torchbrdf.psychophysics.likelihood_ratio import Goodness, goodness
from torchbrdf.psychophysics.observers import ObserverReport, agreement_with_others, observer_reports
from torchbrdf.psychophysics.power import observers_needed, power_of
from torchbrdf.psychophysics.scales import Scales, scale
from torchbrdf.psychophysics.simulate import simulated_wins
from torchbrdf.psychophysics.thurstone import PRIOR, least_squares, map_estimate

__all__ = [
    "PRIOR",
    "Comparisons",
    "Goodness",
    "KendallAgreement",
    "Method",
    "ObserverReport",
    "Scales",
    "agreement_with_others",
    "bootstrap",
    "circular_triads",
    "consistence",
    "goodness",
    "kendall_agreement",
    "least_squares",
    "map_estimate",
    "montag",
    "observer_reports",
    "observers_needed",
    "power_of",
    "scale",
    "simulated_wins",
]
