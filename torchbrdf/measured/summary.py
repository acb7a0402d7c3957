"""What scattered samples are like: angles covered, what is missing or below 0, and reciprocity."""

import numpy as np

from torchbrdf.measured.scattered import tree_of

# Degrees within which two samples are at the same directions, and angles of a light the same.
_SAME, _STEP = 0.05, 0.1
# Degrees within which directions are the same ones again; a share of the value that is rounding.
_REPEATED, _ROUNDING = 1e-3, 1e-5
# What makes a number of a place, by sums that wrap.
_MIXED = np.array([0x9E3779B97F4A7C15, 0xC2B2AE3D27D4EB4F, 0x165667B19E3779F9, 0x27D4EB2F165667C5, 0x85EBCA77C2B2AE63,
                   0xFF51AFD7ED558CCD], dtype=np.uint64).view(np.int64)  # fmt: skip
ALIKE = "with the same values"
"""What is said of repetitions that change nothing."""
# A list of angles that is longer is said by its ends.
_FEW = 12


def summary(
    wi: np.ndarray, wo: np.ndarray, values: np.ndarray, valid: np.ndarray, has_grain: bool = False
) -> dict[str, object]:
    """Facts about samples, by name.

    Args:
        wi: Unit vectors to the light, `(N, 3)`.
        wo: Unit vectors to the viewer, `(N, 3)`.
        values: In 1/sr, `(N, 3)`.
        valid: Which of them count, `(N,)`; one at least.
        has_grain: Whether they are of an anisotropic material.
    """
    wi, wo, known = wi[valid], wo[valid], values[valid]
    theta_i, theta_o = (np.degrees(np.arccos(np.clip(one[:, 2], -1, 1))) for one in (wi, wo))
    turn = np.degrees(np.arctan2(wi[:, 0] * wo[:, 1] - wi[:, 1] * wo[:, 0], wi[:, 0] * wo[:, 0] + wi[:, 1] * wo[:, 1]))
    facts: dict[str, object] = {
        "angles of the light, degrees": _listed(theta_i),
        "angles of the viewer, degrees": _listed(theta_o),
    }
    facts |= {
        "invalid share": float(1 - valid.mean()),
        "negative share": float((known < 0).any(-1).mean()),
    }
    level = np.abs(known.mean(-1))
    if has_grain:
        here, there = (np.degrees(np.concatenate(both, -1)) for both in ((wi, wo), (wo, wi)))
        return facts | _spread("reciprocity error", here, there, known, level, theta_i < theta_o - _STEP)
    # The same light and viewer, mirrored or not; and with both exchanged.
    here, there = (np.stack([*angles, np.abs(turn)], -1) for angles in ((theta_i, theta_o), (theta_o, theta_i)))
    for one, arm in ((here, theta_o), (there, theta_o)):
        one[:, 2] *= np.sin(np.radians(np.minimum(arm, theta_i)))
    facts |= _spread("reciprocity error", here, there, known, level, theta_i < theta_o - _STEP)
    return facts


def are_any_repeated(wi: np.ndarray, wo: np.ndarray) -> bool:
    """Whether there may be samples at the same directions; where not, `repeated` has nothing to say of any of them.

    Args:
        wi: Unit vectors to the light, `(N, 3)`.
        wo: Those to the viewer.
    """
    keys = np.sort(_places(wi, wo) @ _MIXED)  # equal places have equal keys, and others hardly ever
    return bool((keys[1:] == keys[:-1]).any())


def _places(wi: np.ndarray, wo: np.ndarray) -> np.ndarray:
    return np.round(np.concatenate([wi, wo], 1) / np.radians(_REPEATED)).astype(np.int64)


def repeated(wi: np.ndarray, wo: np.ndarray, values: np.ndarray) -> str:
    """What there is to say of samples at the same directions, and whether values are others; "" where there are none.

    Args:
        wi: Unit vectors to the light, `(N, 3)`.
        wo: Those to the viewer.
        values: There, `(N, C)`.
    """
    _, own, count = np.unique(_places(wi, wo), axis=0, return_inverse=True, return_counts=True)
    own = own.reshape(-1)
    several = count > 1
    if not several.any():
        return ""
    level = np.abs(np.stack([np.bincount(own, channel) / count for channel in values.T], -1)).max(1)
    ends = np.full((2, len(count), values.shape[1]), np.inf)
    for end, sign in zip(ends, (1, -1), strict=True):
        np.minimum.at(end, own, sign * values)
    apart = (-ends[1] - ends[0]).max(1) / np.maximum(level, 1e-30)
    other = several & (apart > _ROUNDING)
    if not other.any():
        return f"{int(count[several].sum())} samples at {int(several.sum())} places, {ALIKE}"
    half, most = (100 * float(one(apart[other])) for one in (np.median, np.max))
    size = f"half of them {half:.2g} % apart or more, at most {most:.2g} %"
    return f"{int(count[other].sum())} samples at {int(other.sum())} places, {size}; interpolated by their means"


def _spread(
    name: str, here: np.ndarray, there: np.ndarray, values: np.ndarray, level: np.ndarray, which: np.ndarray
) -> dict[str, object]:
    """How far values are from those of their partners, where there are some: a relative median."""
    if not which.any():
        return {}
    distance, partner = tree_of(here).query(there[which], distance_upper_bound=_SAME)
    found = np.isfinite(distance)
    if not found.any():
        return {}
    one, other = np.flatnonzero(which)[found], partner[found]
    mean = (level[one] + level[other]) / 2
    apart = np.abs(values[one].mean(-1) - values[other].mean(-1)) / np.maximum(mean, 1e-30)
    return {name: f"{100 * float(np.median(apart)):.2g} % (median of {len(one)} pairs of samples)"}


def _listed(angles: np.ndarray) -> str:
    """The angles, if they are few, else how many and from where to where."""
    found = np.unique(np.round(angles / _STEP) * _STEP)
    if len(found) <= _FEW:
        return " ".join(f"{one:g}" for one in np.round(found, 1))
    return f"{found[0]:.3g} to {found[-1]:.3g}, {len(found)} of them"
