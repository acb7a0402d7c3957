"""Measured BRDFs: what was measured, read from files, and figures about it. A format a file."""

from torchbrdf.measured.alta import Alta
from torchbrdf.measured.astm import Astm
from torchbrdf.measured.bird import Bird
from torchbrdf.measured.catalogue import MERL_NAMES, MERL_SHA256, PAPER_TEN, is_merl, merl_name
from torchbrdf.measured.columns import Columns
from torchbrdf.measured.cornell import Cornell
from torchbrdf.measured.describe import describe
from torchbrdf.measured.format import FORMATS, BrdfFormat, Lookup
from torchbrdf.measured.fourier import Fourier
from torchbrdf.measured.fred import Fred
from torchbrdf.measured.gloss import contrast_gloss, distinctness_of_image
from torchbrdf.measured.klems import Klems
from torchbrdf.measured.lighttools import LightTools
from torchbrdf.measured.load import load, load_all
from torchbrdf.measured.mbsdf import Mbsdf
from torchbrdf.measured.measured import Measured, Samples
from torchbrdf.measured.merl import Merl, write_merl, write_raw
from torchbrdf.measured.merl_table import merl_values
from torchbrdf.measured.merl_variants import Merl360, Merl360Single, MerlSingle
from torchbrdf.measured.openmaterial import OpenMaterial
from torchbrdf.measured.plausibility import Plausibility, check, directional_albedo
from torchbrdf.measured.rgl import Rgl
from torchbrdf.measured.rgl_table import write_rgl
from torchbrdf.measured.speos import Speos
from torchbrdf.measured.ssdd import Ssdd
from torchbrdf.measured.standin import StandIn, standins
from torchbrdf.measured.tensor_tree import TensorTree
from torchbrdf.measured.unopened import Unopened, load_later
from torchbrdf.measured.utia import Utia
from torchbrdf.measured.zemax import Zemax

__all__ = [
    "FORMATS",
    "MERL_NAMES",
    "MERL_SHA256",
    "PAPER_TEN",
    "Alta",
    "Astm",
    "Bird",
    "BrdfFormat",
    "Columns",
    "Cornell",
    "Fourier",
    "Fred",
    "Klems",
    "LightTools",
    "Lookup",
    "Mbsdf",
    "Measured",
    "Merl",
    "Merl360",
    "Merl360Single",
    "MerlSingle",
    "OpenMaterial",
    "Plausibility",
    "Rgl",
    "Samples",
    "Speos",
    "Ssdd",
    "StandIn",
    "TensorTree",
    "Unopened",
    "Utia",
    "Zemax",
    "check",
    "contrast_gloss",
    "describe",
    "directional_albedo",
    "distinctness_of_image",
    "is_merl",
    "load",
    "load_all",
    "load_later",
    "merl_name",
    "merl_values",
    "standins",
    "write_merl",
    "write_raw",
    "write_rgl",
]
