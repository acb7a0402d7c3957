"""What a BRDF is made of: lobes, as functions of Pairs and as torch modules. A lobe a file."""

from torchbrdf.lobes.ashikhmin_shirley import AshikhminShirley, ashikhmin_shirley
from torchbrdf.lobes.base import LOBES, Bounded, Lobe, color
from torchbrdf.lobes.cook_torrance import CookTorrance, cook_torrance
from torchbrdf.lobes.distribution_based import DistributionBased, distribution_based
from torchbrdf.lobes.fresnel import schlick
from torchbrdf.lobes.lambert import Lambert, lambert
from torchbrdf.lobes.model import from_parameters, make_model, model_name, parameters
from torchbrdf.lobes.records import model_of, number, read_fits, write_fits
from torchbrdf.lobes.sum import Sum
from torchbrdf.lobes.ward import Ward, ward

__all__ = [
    "LOBES",
    "AshikhminShirley",
    "Bounded",
    "CookTorrance",
    "DistributionBased",
    "Lambert",
    "Lobe",
    "Sum",
    "Ward",
    "ashikhmin_shirley",
    "color",
    "cook_torrance",
    "distribution_based",
    "from_parameters",
    "lambert",
    "make_model",
    "model_name",
    "model_of",
    "number",
    "parameters",
    "read_fits",
    "schlick",
    "ward",
    "write_fits",
]
