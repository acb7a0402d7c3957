"""The MERL database: its 100 names with the checksums of their files, and the ten materials of the study.

Source: the archive doi:10.5281/zenodo.8101680 (CC-BY-SA-4.0); the sha256 sums are those that a public mirror gives.
The ten: A. Fores, J. Ferwerda, J. Gu, Toward a Perceptually Based Metric for BRDF Modeling, 2012.
"""

import hashlib
import json
from importlib.resources import files
from pathlib import Path

from torchbrdf.errors import DataError

PAPER_TEN = (
    "gold-metallic-paint2",
    "aluminium",
    "blue-acrylic",
    "alum-bronze",
    "nylon",
    "nickel",
    "blue-metallic-paint",
    "pearl-paint",
    "light-red-paint",
    "silver-metallic-paint",
)


def merl_name(path: str | Path) -> str | None:
    """Name of the MERL material whose own file this is, by its checksum.

    Args:
        path: Any file.

    Returns:
        One of `MERL_NAMES`, or None if it is none of MERL's files.

    Raises:
        DataError: The file cannot be read.
    """
    try:
        with Path(path).open("rb") as file:
            digest = hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        raise DataError(f"{path}: cannot be read: {error.strerror}") from None
    return _NAMES.get(digest)


def is_merl(path: str | Path) -> bool:
    """Whether a file is one of MERL's own, by its checksum.

    Raises:
        DataError: The file cannot be read.
    """
    return merl_name(path) is not None


MERL_SHA256: dict[str, str] = json.loads((files("torchbrdf.assets") / "merl.json").read_text(encoding="utf-8"))
"""The sha256 sum of each material's file."""

MERL_NAMES = tuple(MERL_SHA256)
_NAMES = {digest: name for name, digest in MERL_SHA256.items()}
