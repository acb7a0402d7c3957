"""Words and cells that the report's parts share."""

from dataclasses import dataclass

LOSS_LABELS = {"rms": "RMS", "cosine": "cosine RMS", "cuberoot": "cube root"}


@dataclass(frozen=True)
class Cell:
    """A cell of a table."""

    text: str
    best: bool = False
    outlier: bool = False


def loss_label(name: str) -> str:
    """A metric's name for people."""
    return LOSS_LABELS.get(name, name.replace("_", " "))


def model_label(name: str) -> str:
    """A model's name for people."""
    return "-".join(word.capitalize() for word in name.split("_"))
