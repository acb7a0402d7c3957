"""How the fit of a texel ended, as a number that a map can hold."""

from enum import IntEnum
from typing import Self

from torchbrdf.solvers import Status


class TexelStatus(IntEnum):
    """How the fit of a texel ended. Only CONVERGED is a minimum.

    Example:
        >>> from torchbrdf.texels import TexelStatus
        >>> TexelStatus(6).name
        'SATURATED'
    """

    CONVERGED = 0
    MAX_ITERATIONS = 1
    STALLED = 2
    NOT_FINITE = 3
    NO_DATA = 4
    TOO_FEW_SAMPLES = 5
    SATURATED = 6
    FAILED = 7

    @classmethod
    def of(cls, status: Status) -> Self:
        """The same of a solver's status."""
        return cls[status.name]

    @property
    def meaning(self) -> str:
        """What it says, in words."""
        return _MEANINGS[self.value]


_MEANINGS = (
    "the fit converged",
    "the solver's iterations were used up",
    "no better point was found, but the slope is not 0",
    "the error is not finite",
    "no valid value",
    "fewer valid values than parameters",
    "so many values are saturated that fewer are left than parameters",
    "the tile could not be read, or its process died twice",
)
