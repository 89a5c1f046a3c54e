"""What several tests of the core begin with."""

from pif_ros.core.active import compiled
from pif_ros.core.batch import Batch
import pytest

#: With the loops over active cells compiled, where they can be, and without.
WAYS = [pytest.param(True, marks=pytest.mark.skipif(
    not compiled.is_available(), reason='numba is not installed')), False]


@pytest.fixture(params=WAYS, ids=['compiled', 'plain'])
def way(request, monkeypatch):
    """Run a test with the loops over active cells compiled, and once more without."""
    monkeypatch.setattr(compiled, 'is_available', lambda: request.param)


@pytest.fixture
def products(monkeypatch):
    """Return the numbers of densities in each product, from now on."""
    widths, product = [], Batch._product

    def counting(self, K, P, other):
        widths.append(P.shape[1])
        return product(self, K, P, other)

    monkeypatch.setattr(Batch, '_product', counting)
    return widths
