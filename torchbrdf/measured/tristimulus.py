"""Colours of what was measured as tristimulus values."""

import numpy as np


def rgb_of_reflected(values: np.ndarray) -> np.ndarray:
    """Linear RGB (BT.709) of tristimulus values of a reflectance; what reflects all alike, X = Y = Z, is white.

    Args:
        values: X, Y and Z, `(N, 3)`.

    Returns:
        `(N, 3)`.

    Example:
        >>> import numpy as np
        >>> from torchbrdf.measured.tristimulus import rgb_of_reflected
        >>> rgb_of_reflected(np.array([[0.5, 0.5, 0.5]])).round(3).tolist()
        [[0.5, 0.5, 0.5]]
    """
    from torchbrdf.images.primaries import XYZ, to_rec709  # late, as pictures take long to import

    equal_energy = (1 / 3, 1 / 3)
    found: np.ndarray = values @ to_rec709("tristimulus values", XYZ, equal_energy).T
    return found
