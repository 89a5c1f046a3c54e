"""What the speed and accuracy tables come from: python -m benchmarks."""

import os

# One thread per library, asked for before numpy loads them: two would measure the neighbours.
for _name in ('OMP', 'OPENBLAS', 'MKL', 'NUMBA'):
    os.environ.setdefault(f'{_name}_NUM_THREADS', '1')
