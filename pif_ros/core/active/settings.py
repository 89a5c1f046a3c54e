"""What decides which cells are kept, and how fine they are."""

from __future__ import annotations

from dataclasses import dataclass, replace


@dataclass(frozen=True)
class RegionSettings:
    """
    How the density is kept where it is.

    negligible: the share of a patch's mass that may be left out each time; resolution: cells per
    standard deviation below which cells are halved; finest: how often an axis may be halved.
    Raises ValueError for what is none of that.
    """

    negligible: float = 1e-5
    resolution: float = 1.3
    finest: int = 4

    def __post_init__(self) -> None:
        """Refuse what would keep nothing, or everything."""
        if not 0 < self.negligible <= 1e-2:
            raise ValueError('negligible: expected a share, above 0 and at most 0.01, '
                             f'got {self.negligible!r}')
        if not 0.5 <= self.resolution <= 20:
            raise ValueError('resolution: expected a number of cells from 0.5 to 20, '
                             f'got {self.resolution!r}')
        if not 0 <= self.finest <= 20 or self.finest != int(self.finest):
            raise ValueError(f'finest: expected a whole number from 0 to 20, got {self.finest!r}')

    def shared(self, count: int) -> RegionSettings:
        """Return what each of so many parts of a step may leave out."""
        return self if count == 1 else replace(self, negligible=self.negligible / count)
