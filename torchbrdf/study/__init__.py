"""Ask people: paired comparisons with a reference, their answers, and what they say.

Nothing here needs torch, so that a server of a study starts at once; scales from answers are in
`torchbrdf.psychophysics`.
"""

from torchbrdf.study.answers import Answer, read_answers, simulated, write_answers
from torchbrdf.study.design import Trial, trials
from torchbrdf.study.plan import MEASURED, Experiment, Material, Plan, Stimulus
from torchbrdf.study.simulation import simulate

__all__ = [
    "MEASURED",
    "Answer",
    "Experiment",
    "Material",
    "Plan",
    "Stimulus",
    "Trial",
    "read_answers",
    "simulate",
    "simulated",
    "trials",
    "write_answers",
]
