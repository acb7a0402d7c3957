"""Scales from paired comparisons, with intervals, tests, and reports on observers."""

from typing import TYPE_CHECKING

from torchbrdf._lazy import exports

if TYPE_CHECKING:
    from torchbrdf.psychophysics.comparisons import Comparisons
    from torchbrdf.psychophysics.intervals import Method, bootstrap, montag
    from torchbrdf.psychophysics.kendall import KendallAgreement, circular_triads, consistence, kendall_agreement
    from torchbrdf.psychophysics.likelihood_ratio import Goodness, goodness
    from torchbrdf.psychophysics.observers import ObserverReport, agreement_with_others, observer_reports
    from torchbrdf.psychophysics.power import observers_needed, power_of
    from torchbrdf.psychophysics.scales import Scales, scale
    from torchbrdf.psychophysics.simulate import simulated_wins
    from torchbrdf.psychophysics.thurstone import PRIOR, least_squares, map_estimate

_HOME = {
    "Comparisons": "comparisons",
    "Method": "intervals",
    "bootstrap": "intervals",
    "montag": "intervals",
    "KendallAgreement": "kendall",
    "circular_triads": "kendall",
    "consistence": "kendall",
    "kendall_agreement": "kendall",
    "Goodness": "likelihood_ratio",
    "goodness": "likelihood_ratio",
    "ObserverReport": "observers",
    "agreement_with_others": "observers",
    "observer_reports": "observers",
    "observers_needed": "power",
    "power_of": "power",
    "Scales": "scales",
    "scale": "scales",
    "simulated_wins": "simulate",
    "PRIOR": "thurstone",
    "least_squares": "thurstone",
    "map_estimate": "thurstone",
}
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

__getattr__, __dir__ = exports(__name__, _HOME)
