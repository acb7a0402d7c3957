"""What a strategy is: a function that fits a model to a problem, stage by stage. A strategy a file."""

from collections.abc import Callable
from dataclasses import dataclass, field

from torchbrdf.fitting.lbfgs import Solution, Status
from torchbrdf.fitting.solve import Task
from torchbrdf.fitting.variables import Values
from torchbrdf.registry import Registry


@dataclass
class Stage:
    """What one stage did for each material."""

    name: str
    error: list[float]
    status: list[Status]
    iterations: list[int]


def joined(stages: list[Stage]) -> Stage:
    """The same stage of several batches of materials as one."""
    return Stage(
        stages[0].name,
        [error for stage in stages for error in stage.error],
        [status for stage in stages for status in stage.status],
        [iterations for stage in stages for iterations in stage.iterations],
    )


@dataclass
class Outcome:
    """The values a strategy has come to, and the stages on the way.

    starts: how many it tried; ties: of each material, how many other minima it found within 1 % of the best error on
    the subset.
    """

    values: Values
    stages: list[Stage] = field(default_factory=list)
    starts: int = 1
    ties: list[int] = field(default_factory=list)

    def add(self, name: str, values: Values, found: Solution) -> None:
        """Record a stage."""
        self.values = values
        self.stages.append(Stage(name, found.value.tolist(), found.status, found.iterations.tolist()))

    def status(self, material: int) -> Status:
        """How the last stage ended."""
        return self.stages[-1].status[material]


Strategy = Callable[[Task, Values, bool], Outcome]

STRATEGIES: Registry[Strategy] = Registry("strategy", "torchbrdf.fitting", "torchbrdf.strategies")
