"""The paper's procedure: lobe after lobe with a scalar albedo, then the colours with the shapes held."""

from collections.abc import Callable, Iterator

from torchbrdf.fitting.lbfgs import Solution
from torchbrdf.fitting.solve import Task, descend, solve
from torchbrdf.fitting.strategy import STRATEGIES, Outcome
from torchbrdf.fitting.variables import Values, Variable

# Minimises over some variables with some parts of the model present.
Minimizer = Callable[[Values, list[Variable], list[int]], tuple[Values, Solution]]


@STRATEGIES.register("staged")
def staged(task: Task, values: Values, fit_diffuse: bool) -> Outcome:
    """Fit as Fores, Ferwerda and Gu (2012) did, to the letter, with a quasi-Newton solver as theirs.

    With the diffuse albedo given, one lobe with a scalar albedo and its shape parameters is fitted; then each further
    lobe is added at its start beside those already found; at last the albedos become RGB and are fitted with the
    shapes held, to a subset and then to all samples. It can end in a local minimum, as theirs did. With `fit_diffuse`
    the diffuse albedo moves throughout.
    """
    outcome = Outcome(values)
    for step in stages(task, values, fit_diffuse, lambda *move: solve(task, *move)):
        outcome.add(*step)
    if task.whole is not None:
        moved = _diffuse(task, fit_diffuse) + _albedos(task)
        finish, start, last = task.finish, outcome.values, task.loss.rounding[-1:]
        if finish.analytic:
            end = descend(finish, task.everyone, start, moved, task.parts, max_iterations=30, rounding=last)
        else:
            end = solve(finish, start, moved, task.parts)
        outcome.add("RGB albedo, shapes held, all samples", *end)
    return outcome


def stages(
    task: Task, values: Values, fit_diffuse: bool, minimizer: Minimizer
) -> Iterator[tuple[str, Values, Solution]]:
    """The stages one after the other: name, values so far, and what the minimizer says."""
    moved = _diffuse(task, fit_diffuse)
    shaped: list[Variable] = []
    for count, k in enumerate(task.specular, start=1):
        for variable in task.variables([k]):
            scalar = variable.bounded.linear and variable.bounded.shape == (3,)
            shaped.append(Variable(k, variable.bounded, 1) if scalar else variable)
        values, found = minimizer(values, moved + shaped, task.diffuse + task.specular[:count])
        yield f"{count} lobe{'s' if count > 1 else ''}, scalar albedo", values, found
    values, found = minimizer(values, moved + _albedos(task), task.parts)
    yield "RGB albedo, shapes held", values, found


def _diffuse(task: Task, fit_diffuse: bool) -> list[Variable]:
    return task.variables(task.diffuse) if fit_diffuse else []


def _albedos(task: Task) -> list[Variable]:
    return [variable for variable in task.variables(task.specular) if variable.bounded.linear]
