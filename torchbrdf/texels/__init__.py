"""A surface as many small problems: one model fitted to every texel of a photometric stack."""

from typing import TYPE_CHECKING

from torchbrdf._lazy import exports

if TYPE_CHECKING:
    from torchbrdf.texels.api import fit_texels
    from torchbrdf.texels.folder import open_texels
    from torchbrdf.texels.maps import TexelMaps
    from torchbrdf.texels.photographs import dome, photograph, relight
    from torchbrdf.texels.status import TexelStatus
    from torchbrdf.texels.synthetic import SyntheticSurface, synthetic_surface

_HOME = {
    "fit_texels": "api",
    "open_texels": "folder",
    "TexelMaps": "maps",
    "dome": "photographs",
    "photograph": "photographs",
    "relight": "photographs",
    "TexelStatus": "status",
    "SyntheticSurface": "synthetic",
    "synthetic_surface": "synthetic",
}
__all__ = [
    "SyntheticSurface",
    "TexelMaps",
    "TexelStatus",
    "dome",
    "fit_texels",
    "open_texels",
    "photograph",
    "relight",
    "synthetic_surface",
]

__getattr__, __dir__ = exports(__name__, _HOME)
