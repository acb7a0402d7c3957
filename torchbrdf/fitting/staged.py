"""The paper's procedure: lobe after lobe with a scalar albedo, then the colours with the shapes held."""

from torchbrdf.fitting.solve import Task, solve
from torchbrdf.fitting.strategy import STRATEGIES, Outcome
from torchbrdf.fitting.variables import Values, Variable
from torchbrdf.lobes import Lambert


@STRATEGIES.register("staged")
def staged(task: Task, values: Values, fit_diffuse: bool) -> Outcome:
    """Fit as Fores, Ferwerda and Gu (2012) did, to the letter.

    With the diffuse albedo given, one lobe with a scalar albedo and its shape parameters is fitted; then each further
    lobe is added at its start beside those already found; at last the albedos become RGB and are fitted with the
    shapes held. It can end in a local minimum, as theirs did. With `fit_diffuse` the diffuse albedo moves throughout.
    """
    parts = task.model.parts()
    diffuse = [k for k, part in enumerate(parts) if isinstance(part, Lambert)]
    specular = [k for k in range(len(parts)) if k not in diffuse]
    moved = [Variable(k, bounded, bounded.size) for k in diffuse for bounded in parts[k].declared.values()]
    moved = moved if fit_diffuse else []
    outcome = Outcome(values)
    shaped: list[Variable] = []
    colored: list[Variable] = []
    for count, k in enumerate(specular, start=1):
        for bounded in parts[k].declared.values():
            scalar = bounded.linear and bounded.shape == (3,)
            shaped.append(Variable(k, bounded, 1 if scalar else bounded.size))
            if bounded.linear:
                colored.append(Variable(k, bounded, bounded.size))
        values, found = solve(task, outcome.values, moved + shaped, diffuse + specular[:count])
        outcome.add(f"{count} lobe{'s' if count > 1 else ''}, scalar albedo", values, found)
    values, found = solve(task, outcome.values, moved + colored, diffuse + specular)
    outcome.add("RGB albedo, shapes held", values, found)
    return outcome
