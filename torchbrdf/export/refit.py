"""What a program has no model for is fitted by one that it has."""

import math
from typing import NamedTuple

import torch
from torch import Tensor

from torchbrdf.errors import DataError
from torchbrdf.export.base import Material
from torchbrdf.fitting import fit
from torchbrdf.fitting.sampling import stratified
from torchbrdf.lobes import Lobe, make_model
from torchbrdf.losses import LOSSES
from torchbrdf.measured import Measured
from torchbrdf.measured.merl import bin_centers
from torchbrdf.pairs import Pairs
from torchbrdf.solvers import Status

LOSS = "compressed"
# Pairs of directions that are fitted, and their largest angle from the normal, in degrees.
SAMPLES = 5_000
MAX_THETA = 80.0
# The same of a model's own values, which are known up to the outline.
MODELS_REACH = 89.0
# What a layer is multiplied by, in any model, and how much larger the error may be without it.
LAYERS = ("sheen_color", "sheen", "fuzz_weight", "clearcoat", "coat_weight")
IDLE = 1.03
# Of a turn: the golden angle.
GOLDEN = math.pi * (3 - math.sqrt(5))
# Ends of a fit after which there is a model.
ENDED = (Status.CONVERGED, Status.MAX_ITERATIONS, Status.STALLED)


class Refit(NamedTuple):
    """A model fitted to a BRDF.

    Attributes:
        model: Not batched.
        error: Under the loss named `LOSS`, on the pairs that were fitted.
        note: What was done, in one line.
    """

    model: Lobe
    error: float
    note: str


def refit(material: Material, model: str) -> Refit:
    """Fit a model to a material: to what was measured, or to a model's own values.

    Args:
        material: Of any BRDF.
        model: Registered name of a lobe that is a whole material, such as "gltf", or of any model.

    Returns:
        The fit. One that ended before its minimum says so in its note.

    Raises:
        DataError: It cannot be fitted.

    Example:
        >>> from torchbrdf.export import Material
        >>> from torchbrdf.lobes import GGX
        >>> refit(Material("grey", GGX(specular=0.5, roughness=0.3)), "beckmann").error < 0.2
        True
    """
    measured = _some(material.brdf) if isinstance(material.brdf, Measured) else _values_of(material.brdf, material.name)
    if not bool((measured.weight > 0).any()):
        raise DataError(f"{material.name}: expected valid samples within {MAX_THETA:g} degrees, found none")
    reach = MAX_THETA if isinstance(material.brdf, Measured) else MODELS_REACH
    result = fit(make_model(model), measured, LOSSES[LOSS](), diffuse="fit", samples=None, max_theta=reach)
    (status,), (reason,), error = result.status, result.reason, result.error.item()
    if status not in ENDED:
        raise DataError(f"{material.name}: cannot be refitted as {model}: {reason}")
    early = "" if status == Status.CONVERGED else f"; not converged: {reason}"
    fitted, error = _without_idle_layers(_first(result.model), measured, error)
    grain = isinstance(material.brdf, Lobe) and material.brdf.is_anisotropic and not fitted.is_anisotropic
    lost = "; without its grain" if grain else ""
    return Refit(fitted, error, f"refitted as {model} under {LOSS}: error {error:.3g}{lost}{early}")


def _without_idle_layers(model: Lobe, measured: Measured, error: float) -> tuple[Lobe, float]:
    """The model without layers that hardly better its error, and its error.

    Such a layer is seen where nothing was fitted: a narrow sheen of any colour lights up at the outline.
    """
    loss = LOSSES[LOSS]()
    for part in model.components():
        for name in LAYERS:
            if name in part.parameter_specs:
                kept = getattr(part, name).detach().clone()
                setattr(part, name, torch.zeros_like(kept))
                with torch.no_grad():
                    without = loss(model(measured.pairs), measured.values, measured.pairs, measured.weight).item()
                if without <= IDLE * error:
                    error = without
                else:
                    setattr(part, name, kept)
    return model, error


def _some(measured: Measured) -> Measured:
    """Some of what was measured."""
    measured = measured.within(MAX_THETA)
    return measured.batch(samples=stratified(len(measured.pairs), SAMPLES, seed=0))


def _values_of(model: Lobe, name: str) -> Measured:
    """A model's values at some of MERL's bins, as if they had been measured."""
    pairs = bin_centers()
    pairs = Pairs.from_half_diff(pairs.theta_h, pairs.theta_d, pairs.phi_d, _all_round(len(pairs)))
    dtype = next(model.parameters()).dtype
    pairs = pairs.select(samples=stratified(len(pairs), SAMPLES, seed=0)).to(dtype=dtype)
    with torch.no_grad():
        values = model(pairs).expand(1, -1, -1)
    return Measured.from_samples(pairs, values, names=[name])


def _all_round(count: int) -> Tensor:
    """Azimuths of half vectors in no order, `(1, count)`."""
    return (torch.arange(count, dtype=torch.float64, device="cpu") * GOLDEN).remainder(2 * math.pi)[None]


def _first(model: Lobe) -> Lobe:
    """The only material of a batched model, as a model that is not batched."""
    for part in model.components():
        for name in part.parameter_specs:
            part._parameters[name] = torch.nn.Parameter(getattr(part, name).detach()[0])
    return model
