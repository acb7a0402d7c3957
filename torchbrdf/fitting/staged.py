"""The paper's procedure: lobe after lobe with a scalar albedo, then the colours with the shapes held."""

from collections.abc import Callable, Iterator

import torch

from torchbrdf.fitting.objective import GaussNewtonObjective
from torchbrdf.fitting.parameters import FreeParameter, Parametrization, colour_specs, free_parameters
from torchbrdf.fitting.strategy import STRATEGIES, Outcome
from torchbrdf.fitting.task import Task, lbfgs_fit, levenberg_marquardt_fit
from torchbrdf.lobes.parameter_dict import ParameterDict, component_names
from torchbrdf.solvers import Solution

# Minimises over some parameters, from some values.
Minimizer = Callable[[ParameterDict, Parametrization], tuple[ParameterDict, Solution]]


@STRATEGIES.register("staged")
def staged(task: Task, values: ParameterDict, fit_diffuse: bool) -> Outcome:
    """Fit as Fores, Ferwerda and Gu (2012) did, to the letter, with a quasi-Newton solver as theirs.

    With the diffuse albedo given, one lobe with a scalar albedo and its shape parameters is fitted; then each further
    lobe is added at its start beside those already found; at last the albedos become RGB and are fitted with the
    shapes held, to a subset and then to all samples. It can end in a local minimum, as theirs did. With `fit_diffuse`
    the diffuse albedo moves throughout. A lobe with a grain, which the paper has none of, starts with the grain in four
    directions, and the best goes on.
    """
    outcome = Outcome(values)
    for step in stages(task, values, fit_diffuse, minimizer_of(task)):
        outcome.add(*step)
    if task.full is not None:
        albedos = task.parametrization(_diffuse(task, fit_diffuse) + _albedos(task))
        if isinstance(task.full, GaussNewtonObjective):
            last = task.full.loss.smoothing_widths[-1:]
            end = levenberg_marquardt_fit(task.full, outcome.values, albedos, max_iterations=30, widths=last)
        else:
            end = lbfgs_fit(task.full, outcome.values, albedos, max_iterations=task.max_iterations)
        outcome.add("RGB albedo, shapes held, all samples", *end)
    return outcome


def minimizer_of(task: Task) -> Minimizer:
    """The general solver on a task's objective."""

    def minimize(values: ParameterDict, parametrization: Parametrization) -> tuple[ParameterDict, Solution]:
        return lbfgs_fit(task.objective, values, parametrization, max_iterations=task.max_iterations)

    return minimize


def stages(
    task: Task, values: ParameterDict, fit_diffuse: bool, minimize: Minimizer
) -> Iterator[tuple[str, ParameterDict, Solution]]:
    """The stages one after the other: name, values so far, and what the minimizer says."""
    diffuse = _diffuse(task, fit_diffuse)
    for count in range(1, len(task.specular) + 1):
        shaped = free_parameters(task.model, task.specular[:count], scalar_albedo=True)
        components = task.diffuse + task.specular[:count]
        parametrization = task.parametrization(diffuse + shaped, components)
        values, found = _best_of(
            [minimize(start, parametrization) for start in _starts(task, values, task.specular[count - 1])]
        )
        yield f"{count} lobe{'s' if count > 1 else ''}, scalar albedo", values, found
    values, found = minimize(values, task.parametrization(diffuse + _albedos(task)))
    yield "RGB albedo, shapes held", values, found


def _starts(task: Task, values: ParameterDict, component: int) -> list[ParameterDict]:
    """Where the minimizer starts for one more component: at its start, and where else it asks for."""
    names = component_names(task.model)[component]
    own = {name: values[full] for name, full in names.items()}
    others = task.model.components()[component].other_starts(own)
    return [values, *(values | {full: other[name] for name, full in names.items()} for other in others)]


def _best_of(found: list[tuple[ParameterDict, Solution]]) -> tuple[ParameterDict, Solution]:
    """Of each material the end with the least error."""
    if len(found) == 1:
        return found[0]
    best = torch.stack([end.value.nan_to_num(torch.inf) for _, end in found]).argmin(0)
    rows = torch.arange(len(best), dtype=torch.int64, device=best.device)
    values = {name: torch.stack([own[name] for own, _ in found])[best, rows] for name in found[0][0]}
    ends = [end for _, end in found]
    return values, Solution(
        torch.stack([end.x for end in ends])[best, rows],
        torch.stack([end.value for end in ends])[best, rows],
        [ends[k].status[row] for row, k in enumerate(best.tolist())],
        torch.stack([end.iterations for end in ends])[best.cpu(), rows.cpu()],
    )


def _diffuse(task: Task, fit_diffuse: bool) -> list[FreeParameter]:
    return free_parameters(task.model, task.diffuse) if fit_diffuse else []


def _albedos(task: Task) -> list[FreeParameter]:
    """The colours of the lobes; of lobes without any, all parameters."""
    free, components = free_parameters(task.model, task.specular), task.model.components()
    colours = [one for one in free if one.spec.linear or one.spec in colour_specs(type(components[one.component]))]
    return colours or free
