"""Scales from paired comparisons beside a loop of scipy's: `python benchmarks/scales.py`.

The paper's first experiment (10 materials, 9 stimuli, 15 observers), its bootstrap over observers: 10,000 scales.
"""

import numpy as np
import torch
from common import Timer
from scipy.optimize import minimize
from scipy.stats import norm

from torchbrdf.psychophysics import PRIOR, Comparisons, bootstrap, map_estimate, scale, simulated_wins

MATERIALS, STIMULI, OBSERVERS, DRAWS, LOOPED = 10, 9, 15, 1000, 200


def by_scipy(wins, sigma):
    """One most likely scale, by BFGS with the exact gradient."""

    def objective(s):
        apart = s[:, None] - s
        log = norm.logcdf(apart)
        pull = wins * np.exp(norm.logpdf(apart) - log)
        value = -(wins * log).sum() + 0.5 * (s**2).sum() / sigma**2
        return value, -(pull.sum(1) - pull.sum(0)) + s / sigma**2

    return minimize(objective, np.zeros(len(wins)), jac=True, method="BFGS").x


def main():
    generator = torch.Generator().manual_seed(0)
    true = torch.randn(MATERIALS, STIMULI, generator=generator, dtype=torch.float64) * 0.7
    once = 1 - torch.eye(STIMULI, dtype=torch.float64)
    wins = simulated_wins(true.expand(OBSERVERS, -1, -1), once, generator)
    names = [[f"s{k}" for k in range(STIMULI)]] * MATERIALS
    comparisons = Comparisons([f"m{k}" for k in range(MATERIALS)], names, [f"o{k}" for k in range(OBSERVERS)], wins)
    bootstrap(comparisons, 10)
    with Timer() as ours:
        bootstrap(comparisons, DRAWS)
    with Timer() as whole:
        scale(comparisons, draws=DRAWS)
    sigma = PRIOR * ((STIMULI**2 - 1) / 12) ** 0.5
    drawn = torch.randint(OBSERVERS, (LOOPED // MATERIALS, OBSERVERS), generator=generator)
    problems = wins[drawn].sum(1).reshape(-1, STIMULI, STIMULI)
    with Timer() as scipys:
        found = np.stack([by_scipy(one.numpy(), sigma) for one in problems])
    apart = np.abs(found - map_estimate(problems)[0].numpy()).max()
    each, other = ours.clock / (DRAWS * MATERIALS), scipys.clock / len(problems)
    print(f"{DRAWS * MATERIALS} scales: {ours.clock:.2f} s, {each * 1e6:.0f} us each")
    print(f"scipy's BFGS, exact gradient: {other * 1e6:.0f} us each, {other / each:.0f} times; {apart:.1g} apart")
    print(f"scales, intervals and test of fit, {DRAWS} draws: {whole.clock:.2f} s")


if __name__ == "__main__":
    main()
