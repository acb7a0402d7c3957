"""What a BRDF is made of: lobes, as functions of Pairs and as torch modules. A lobe a file."""

from torchbrdf.lobes._microfacet import apply_albedo, clamp_cosine
from torchbrdf.lobes.abc_distribution import LowABC, abc
from torchbrdf.lobes.abc_smooth import LowABCSmooth, abc_smooth
from torchbrdf.lobes.ashikhmin_shirley import AshikhminShirley, ashikhmin_shirley
from torchbrdf.lobes.ashikhmin_shirley_anisotropic import AshikhminShirleyAnisotropic, ashikhmin_shirley_anisotropic
from torchbrdf.lobes.ashikhmin_shirley_ior import AshikhminShirleyIOR, ashikhmin_shirley_ior
from torchbrdf.lobes.base import LOBES, Lobe
from torchbrdf.lobes.beckmann import Beckmann, beckmann
from torchbrdf.lobes.blinn_phong import BlinnPhong, blinn_phong
from torchbrdf.lobes.charlie import Charlie, charlie
from torchbrdf.lobes.cook_torrance import CookTorrance, cook_torrance
from torchbrdf.lobes.cook_torrance_ior import CookTorranceIOR, cook_torrance_ior
from torchbrdf.lobes.distribution_based import DistributionBased, distribution_based
from torchbrdf.lobes.duer import Duer, duer
from torchbrdf.lobes.eon import EON, eon
from torchbrdf.lobes.fits import OutsideBoundsWarning, read_fits, write_fits
from torchbrdf.lobes.fresnel import conductor, dielectric, schlick
from torchbrdf.lobes.ggx import GGX, ggx
from torchbrdf.lobes.ggx_anisotropic import GGXAnisotropic, ggx_anisotropic
from torchbrdf.lobes.ggx_f82 import GGXF82, ggx_f82
from torchbrdf.lobes.gltf import GLTF, gltf
from torchbrdf.lobes.gltf_anisotropic import GLTFAnisotropic, gltf_anisotropic
from torchbrdf.lobes.gtr import GTR, gtr
from torchbrdf.lobes.he import He, he
from torchbrdf.lobes.lafortune import Lafortune, lafortune
from torchbrdf.lobes.lambert import Lambert, lambert
from torchbrdf.lobes.model import from_parameters, make_model, model_name, parameters
from torchbrdf.lobes.openpbr import OpenPBR, openpbr
from torchbrdf.lobes.openpbr_anisotropic import OpenPBRAnisotropic, openpbr_anisotropic
from torchbrdf.lobes.oren_nayar import OrenNayar, oren_nayar
from torchbrdf.lobes.parameter import BoundedParameter, albedo
from torchbrdf.lobes.principled import Principled, principled
from torchbrdf.lobes.records import FitRecord, model_of
from torchbrdf.lobes.roughconductor import RoughConductor, roughconductor
from torchbrdf.lobes.roughconductor_anisotropic import RoughConductorAnisotropic, roughconductor_anisotropic
from torchbrdf.lobes.roughness import (
    ROUGHNESS,
    RoughnessConvention,
    alpha_to_exponent,
    alpha_to_roughness,
    exponent_to_alpha,
    roughness_to_alpha,
)
from torchbrdf.lobes.roughplastic import RoughPlastic, roughplastic
from torchbrdf.lobes.shifted_gamma import ShiftedGamma, shifted_gamma
from torchbrdf.lobes.student_t import StudentT, student_t
from torchbrdf.lobes.sum import Sum
from torchbrdf.lobes.terms import Separable
from torchbrdf.lobes.ward import Ward, ward
from torchbrdf.lobes.ward_anisotropic import WardAnisotropic, ward_anisotropic
from torchbrdf.lobes.ward_duer import WardDuer, ward_duer
from torchbrdf.lobes.zoo import zoo_names

__all__ = [
    "EON",
    "GGX",
    "GGXF82",
    "GLTF",
    "GTR",
    "LOBES",
    "ROUGHNESS",
    "AshikhminShirley",
    "AshikhminShirleyAnisotropic",
    "AshikhminShirleyIOR",
    "Beckmann",
    "BlinnPhong",
    "BoundedParameter",
    "Charlie",
    "CookTorrance",
    "CookTorranceIOR",
    "DistributionBased",
    "Duer",
    "FitRecord",
    "GGXAnisotropic",
    "GLTFAnisotropic",
    "He",
    "Lafortune",
    "Lambert",
    "Lobe",
    "LowABC",
    "LowABCSmooth",
    "OpenPBR",
    "OpenPBRAnisotropic",
    "OrenNayar",
    "OutsideBoundsWarning",
    "Principled",
    "RoughConductor",
    "RoughConductorAnisotropic",
    "RoughPlastic",
    "RoughnessConvention",
    "Separable",
    "ShiftedGamma",
    "StudentT",
    "Sum",
    "Ward",
    "WardAnisotropic",
    "WardDuer",
    "abc",
    "abc_smooth",
    "albedo",
    "alpha_to_exponent",
    "alpha_to_roughness",
    "apply_albedo",
    "ashikhmin_shirley",
    "ashikhmin_shirley_anisotropic",
    "ashikhmin_shirley_ior",
    "beckmann",
    "blinn_phong",
    "charlie",
    "clamp_cosine",
    "conductor",
    "cook_torrance",
    "cook_torrance_ior",
    "dielectric",
    "distribution_based",
    "duer",
    "eon",
    "exponent_to_alpha",
    "from_parameters",
    "ggx",
    "ggx_anisotropic",
    "ggx_f82",
    "gltf",
    "gltf_anisotropic",
    "gtr",
    "he",
    "lafortune",
    "lambert",
    "make_model",
    "model_name",
    "model_of",
    "openpbr",
    "openpbr_anisotropic",
    "oren_nayar",
    "parameters",
    "principled",
    "read_fits",
    "roughconductor",
    "roughconductor_anisotropic",
    "roughness_to_alpha",
    "roughplastic",
    "schlick",
    "shifted_gamma",
    "student_t",
    "ward",
    "ward_anisotropic",
    "ward_duer",
    "write_fits",
    "zoo_names",
]
