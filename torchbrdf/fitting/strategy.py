"""What a strategy is: a function that fits a model to a problem, stage by stage. A strategy a file."""

from collections.abc import Callable
from dataclasses import dataclass, field

from torchbrdf import kinds
from torchbrdf.fitting.task import Task
from torchbrdf.lobes.parameter_dict import ParameterDict
from torchbrdf.registry import Registry
from torchbrdf.solvers import Solution, Status


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

    starts: how many it tried; near_optimal: of each material, how many other minima it found close to the best error
    on the subset; chosen: of each, the loss whose fit was kept, where several were tried.
    """

    values: ParameterDict
    stages: list[Stage] = field(default_factory=list)
    starts: int = 1
    near_optimal: list[int] = field(default_factory=list)
    chosen: list[str] = field(default_factory=list)

    def add(self, name: str, values: ParameterDict, found: Solution) -> None:
        """Record a stage."""
        self.values = values
        self.stages.append(Stage(name, found.value.tolist(), found.status, found.iterations.tolist()))

    def status(self, material: int) -> Status:
        """How the last stage ended."""
        return self.stages[-1].status[material]


# A function of the task, the parameters at the start, and whether the diffuse albedo is fitted.
Strategy = Callable[[Task, ParameterDict, bool], Outcome]

STRATEGIES: Registry[Strategy] = kinds.STRATEGIES


def strategy_name(strategy: str | Strategy) -> str:
    """The name that a strategy is registered under; of another one, what it calls itself, in one line."""
    if isinstance(strategy, str):
        return STRATEGIES.canonical(strategy)
    return STRATEGIES.name_of(strategy) or " ".join(str(getattr(strategy, "__name__", repr(strategy))).split())
