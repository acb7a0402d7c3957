"""Plans whose pictures are as far from their references as is said, for simulated observers."""

from torchbrdf.study import Experiment, Material, Plan, Stimulus


def make_plan(differences, orders=None):
    """A plan: differences[material][stimulus name], a stimulus MODEL-LOSS or measured."""
    materials = []
    for k, (name, own) in enumerate(differences.items()):
        stimuli = {}
        for stimulus, difference in own.items():
            model, _, loss = stimulus.partition("-")
            stimuli[stimulus] = Stimulus(
                f"{name}-{stimulus}.png", model if loss else None, loss or None, False, difference
            )
        materials.append(Material(name, f"{name}.png", stimuli, order=orders[k] if orders else float(k)))
    names = tuple(next(iter(differences.values())))
    return Plan(tuple(materials), (Experiment("1", "all", names),))


def wards(rms, cosine, cube_root):
    return {"ward-rms": rms, "ward-cosine_rms": cosine, "ward-cube_root": cube_root}
