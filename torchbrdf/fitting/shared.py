"""What fits of the same materials by one model after the other share: targets as a loss compares them, laid out."""

import threading
from collections.abc import Hashable
from typing import Any, NamedTuple

from torchbrdf.fitting.objective import FitObjective
from torchbrdf.losses import Problem

# Values of all problems that are kept, at about 12 bytes each beside those of the measurement.
MOST = 12_000_000


class Objectives(NamedTuple):
    """Of some materials under one loss.

    Args:
        whole: all pairs.
        some: those that a solver sees; None: all.
        full: the objective of all pairs.
        seen: of those that a solver sees.
    """

    whole: Problem
    some: Problem | None
    full: FitObjective
    seen: FitObjective


class Shared:
    """Objectives that were made last, for whoever comes next: one at a time, as they work in memory of their own.

    Args:
        most: how many values their problems may have together.
    """

    def __init__(self, most: int = MOST) -> None:
        self.most, self._lock = most, threading.Lock()
        self._kept: dict[Hashable, Objectives] = {}

    def take(self, key: Hashable) -> Objectives | None:
        """What was put there, which is then gone; None: nothing."""
        with self._lock:
            return self._kept.pop(key, None)

    def put(self, key: Hashable, objectives: Objectives) -> None:
        """Keep them, and of those before as many as there is room for."""
        with self._lock:
            self._kept[key] = objectives
            room = self.most
            for own, one in reversed(list(self._kept.items())):
                room -= one.whole.target.numel()
                if room < 0:
                    del self._kept[own]

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickled without what another process makes for itself."""
        return Shared, (self.most,)
