"""How paths are drawn."""

from __future__ import annotations

from dataclasses import dataclass
import math


@dataclass(frozen=True)
class SamplerSettings:
    """
    How paths are drawn.

    chains: how many at once; draws: kept of each; warm_up: rounds that are not kept, in which the
    step and the preconditioner are adapted; particles: of the particle move that each round
    begins with, 0 for none; moves: Hamiltonian moves after it, 0 for none; travel: the longest of
    them, in widths of the posterior; temperatures: with more than 1, each chain is accompanied by
    others that feel only a share of the log likelihood, down to least_share, and after each move
    they may exchange paths; thinning: rounds per draw.  Raises ValueError for what draws nothing.

    Particles change humps where states are few, however long the window; temperatures where
    states are many and the window is short.
    """

    chains: int = 8
    draws: int = 500
    warm_up: int = 100
    particles: int = 256
    moves: int = 1
    travel: float = 3.0
    temperatures: int = 1
    least_share: float = 0.1
    thinning: int = 1

    def __post_init__(self) -> None:
        """Refuse what draws nothing."""
        for name, least in (('chains', 1), ('draws', 4), ('warm_up', 0), ('moves', 0),
                            ('particles', 0), ('temperatures', 1), ('thinning', 1)):
            if not getattr(self, name) >= least:
                raise ValueError(f'{name}: expected {least} or more, got {getattr(self, name)!r}')
        if self.particles == 1 or not (self.particles or self.moves):
            raise ValueError('particles: expected 2 or more, or 0 with moves, '
                             f'got {self.particles} with {self.moves} moves')
        if self.temperatures > 1 and not self.moves:
            raise ValueError('moves: expected 1 or more where there are temperatures, '
                             f'got {self.moves}')
        if not 0 <= self.least_share < 1:
            raise ValueError('least_share: expected a share, 0 to below 1, '
                             f'got {self.least_share!r}')
        if not 0 < self.travel < math.inf:
            raise ValueError(f'travel: expected a positive number, got {self.travel!r}')
