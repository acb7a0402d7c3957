"""Names of models, losses and differences for people, and what has to be said of results."""

from torchbrdf.images import DIFFERENCES
from torchbrdf.lobes.model import JOIN, SHARE
from torchbrdf.losses import LOSSES

STAND_IN = "stand-in materials, not measurements"
# What is not made of a name by writing its words apart.
LOSS_LABELS = {"rms": "RMS", "cosine_rms": "cosine RMS", "solid_angle_cosine_rms": "solid-angle cosine RMS"}
MODEL_LABELS = {
    "abc": "ABC",
    "abc_smooth": "ABC, smooth",
    "ashikhmin_shirley_ior": "Ashikhmin-Shirley, index",
    "cook_torrance_ior": "Cook-Torrance, index",
    "distribution_based": "distribution-based",
    "eon": "EON",
    "ggx": "GGX",
    "ggx_f82": "GGX F82",
    "gltf": "glTF",
    "gtr": "GTR",
    "openpbr": "OpenPBR",
    "principled": "principled",
    "sgd": "SGD",
    "shifted_gamma": "shifted gamma",
}
DIFFERENCE_LABELS = {
    "psnr": "PSNR",
    "ssim": "SSIM",
    "ms_ssim": "MS-SSIM",
    "flip": "FLIP",
    "delta_e76": "ΔE 76",
    "delta_e2000": "ΔE 2000",
    "delta_e_itp": "ΔE ITP",
    "delta_e_itp_hdr": "ΔE ITP, HDR",
    "jod": "10 - JOD",
    "pu_psnr": "PU-PSNR",
    "pu_ssim": "PU-SSIM",
    "log_hdr": "log HDR",
    "compressed_hdr": "compressed HDR",
}


def loss_label(name: str) -> str:
    """A loss's name for people.

    Example:
        >>> loss_label("cosine_rms"), loss_label("learned+rendered_delta_e76"), loss_label("image_driven_delta_e76")
        ('cosine RMS', 'learned + rendered ΔE 76', 'image-driven ΔE 76')
    """
    if "+" in name:
        return " + ".join(map(loss_label, name.split("+")))
    for start, label in (("rendered_", "rendered"), ("image_driven_", "image-driven")):
        if name.startswith(start):
            return f"{label} {difference_label(name.removeprefix(start))}"
    name = LOSSES.canonical(name)
    return LOSS_LABELS.get(name, name.replace("_", " "))


def difference_label(name: str) -> str:
    """An image difference's name for people."""
    name = DIFFERENCES.canonical(name)
    return DIFFERENCE_LABELS.get(name, name.replace("_", " "))


def model_label(name: str) -> str:
    """A model's name for people; those that are named after people have capitals.

    Example:
        >>> model_label("cook_torrance"), model_label("oren_nayar+ggx")
        ('Cook-Torrance', 'Oren-Nayar + GGX')
        >>> model_label("ggx:f0")
        'GGX, one f0'
    """
    name, colon, shared = name.partition(SHARE)
    if colon:
        return f"{model_label(name)}, one {shared.replace(',', ', ')}"
    if JOIN in name:
        return f" {JOIN} ".join(map(model_label, name.split(JOIN)))
    return MODEL_LABELS.get(name) or "-".join(word.capitalize() for word in name.split("_"))


def diffuse_label(mode: str) -> str:
    """How fits treat the diffuse albedo, for people: nothing where a record does not say.

    Example:
        >>> diffuse_label("45:0"), diffuse_label("fit")
        ('diffuse held at 45:0', 'diffuse fitted')
    """
    return {"45:0": "diffuse held at 45:0", "fit": "diffuse fitted"}.get(mode, mode)


def caveat(stand_in: bool, *others: str) -> str:
    """What has to be written on a figure: that it shows stand-ins, and whatever else there is."""
    return "; ".join([*([STAND_IN] if stand_in else []), *(other for other in others if other)])
