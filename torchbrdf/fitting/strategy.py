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
    """The values a strategy has come to, and the stages on the way."""

    values: Values
    stages: list[Stage] = field(default_factory=list)

    def add(self, name: str, values: Values, found: Solution) -> None:
        """Record a stage."""
        self.values = values
        self.stages.append(Stage(name, found.value.tolist(), found.status, found.iterations.tolist()))

    def status(self, material: int) -> Status:
        """Converged if every stage was; else the last that was not."""
        odd = [stage.status[material] for stage in self.stages if stage.status[material] != Status.CONVERGED]
        return odd[-1] if odd else Status.CONVERGED


Strategy = Callable[[Task, Values, bool], Outcome]

STRATEGIES: Registry[Strategy] = Registry("strategy", "torchbrdf.fitting")
