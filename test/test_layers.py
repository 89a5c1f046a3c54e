"""Imports point one way, and ROS stays outside the core."""

import ast
from collections.abc import Iterator
from graphlib import TopologicalSorter
from pathlib import Path
import subprocess
import sys

import pytest

ROOT = Path(__file__).resolve().parents[1]

#: From the ground up: a module imports from lower lines only.  The entry points of TOP stand above
#: all of it, and nothing imports them but each other.
LAYERS = [
    ['', 'core', 'core.compiler', 'fields', 'share', 'process'],
    ['core.grid', 'core.posterior', 'core.tails'],
    ['core.modes'],
    ['core.belief'],
    ['core.models', 'core.scoring'],
    ['core.controls', 'core.systems.system', 'core.kernels.settings'],
    ['core.simulation'],
    ['core.systems.scalar', 'core.systems.coupled', 'core.systems.robots',
     'core.kernels.formula', 'core.kernels.lattice', 'core.kernels.loops'],
    ['core.systems', 'core.kernels.moments', 'core.kernels.blocks', 'core.kernels.single'],
    ['core.kernels.sampled', 'core.kernels.thin'],
    ['core.kernels.multiplicative', 'core.kernels.tilted', 'core.kernels.directions'],
    ['core.kernels.stencils'],
    ['core.kernels.tabulated', 'core.kernels.stored', 'core.kernels.composed',
     'core.kernels.wavelets'],
    ['core.kernels.operators', 'core.kernels.split'],
    ['core.kernels.ladder'],
    ['core.kernels.forms'],
    ['core.kernels', 'core.likelihood', 'core.clutter', 'core.lost'],
    ['core.predictive'],
    ['core.active.window', 'core.active.settings', 'core.active.compiled'],
    ['core.active.pieces'],
    ['core.active.belief', 'core.active.flow'],
    ['core.active.regions', 'core.active.resolution', 'core.active.transport'],
    ['core.active.focus', 'core.active.parting'],
    ['core.active.measured', 'core.active.priors'],
    ['core.active.filter'],
    ['core.active'],
    ['core.filters'],
    ['core.guard'],
    ['core.estimates', 'core.batch', 'core.rivals.passage', 'core.continuous.increments'],
    ['core.timeline'],
    ['core.steering'],
    ['core.tracker'],
    ['core.smoothing', 'core.bank', 'core.rivals.cloud', 'core.rivals.gaussian',
     'core.continuous.path', 'core.continuous.splitting', 'core.continuous.yau'],
    ['core.rivals.particles', 'core.rivals.unscented', 'core.continuous.dirac_feynman_yau',
     'core.path_monte_carlo.diagnostics', 'core.path_monte_carlo.settings'],
    ['core.rivals', 'core.path_monte_carlo.posterior'],
    ['core.continuous.kalman_bucy', 'core.path_monte_carlo.hamiltonian',
     'core.path_monte_carlo.particles', 'core.path_monte_carlo.tempering'],
    ['core.continuous', 'core.path_monte_carlo.rounds'],
    ['core.path_monte_carlo.sampler', 'core.saved.beliefs'],
    ['core.path_monte_carlo', 'core.saved.memory'],
    ['core.saved'],
    ['config.kinds', 'state_file'],
    ['config.sections'],
    ['config.table'],
    ['config.filters'],
    ['config.guard', 'config.probe'],
    ['config.build'],
    ['config.identity'],
    ['config.bank'],
    ['config'],
    ['stopwatch', 'timekeeper', 'traffic'],
    ['accounts'],
    ['parameters', 'diagnostics', 'interface', 'scenario', 'keeper'],
    ['conversions', 'pace', 'epoch'],
    ['sources', 'reference', 'health', 'mode_messages', 'verdicts'],
    ['inbox', 'mode_outputs', 'resuming', 'simulation_node', 'start'],
    ['outputs', 'listener', 'managed_node'],
    ['poses'],
    ['filter_node'],
    ['filter_bank'],
    ['node', 'simulate'],
    ['bank'],
]
TOP = ('plaza', 'reproduction')

#: What the core may import besides numpy and scipy, and where: only when it is asked for.
OPTIONAL = {'core.kernels.wavelets': {'pywt'}, 'core.active.compiled': {'numba'},
            'core.compiler': {'numba'}, 'core.kernels.loops': {'llvmlite', 'numba'},
            'core.posterior': {'numba'}}

#: Who may speak to rclpy, and who of them handles messages.
SPEAKS_ROS = {'parameters', 'outputs', 'mode_outputs', 'filter_node', 'filter_bank', 'node',
              'interface', 'conversions', 'mode_messages', 'health', 'listener', 'managed_node',
              'resuming',
              'start', 'timekeeper', 'simulate', 'simulation_node',
              'plaza.player', 'plaza.player_node', 'plaza.recorder', 'plaza.demonstration'}
HANDLES_MESSAGES = {'conversions', 'mode_messages', 'interface', 'filter_node', 'simulation_node',
                    'managed_node', 'resuming', 'start',
                    'plaza.player_node', 'plaza.recorder'}


def modules() -> dict[str, Path]:
    """Return the files of the package by module, without the package's own name."""
    found = {}
    for file in (ROOT / 'pif_ros').rglob('*.py'):
        parts = file.relative_to(ROOT / 'pif_ros').with_suffix('').parts
        found['.'.join(parts[:-1] if parts[-1] == '__init__' else parts)] = file
    return found


MODULES = modules()


def imports(module: str) -> Iterator[str]:
    """Yield the full names of what a module imports, wherever in it that stands."""
    for node in ast.walk(ast.parse(MODULES[module].read_text())):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert not node.level, f'{module} imports by relative names'
            for alias in node.names:
                whole = f'{node.module}.{alias.name}'
                yield whole if whole.removeprefix('pif_ros.') in MODULES else node.module


def own(module: str) -> set[str]:
    """Return the modules of the package that a module imports."""
    return {name.removeprefix('pif_ros').removeprefix('.') for name in imports(module)
            if name.split('.')[0] == 'pif_ros'}


def others(module: str) -> set[str]:
    """Return the packages outside the standard library that a module imports."""
    return {name.split('.')[0] for name in imports(module)} - sys.stdlib_module_names - {'pif_ros'}


def carries_messages(package: str) -> bool:
    return package.endswith(('_msgs', '_srvs')) or package == 'builtin_interfaces'


def is_ros(package: str) -> bool:
    return carries_messages(package) or package.startswith(('ament', 'rcl', 'ros', 'tf2'))


def test_the_walk_sees_what_is_imported():
    assert {'core.grid', 'core.kernels', 'core.models'} <= own('core.filters')
    assert own('core.grid') == set()
    assert {'numpy', 'scipy'} == others('core.kernels.tabulated')
    assert is_ros('rclpy') and is_ros('std_srvs') and not is_ros('numpy')
    assert any(is_ros(package) for module in MODULES for package in others(module))


def test_every_module_stands_in_one_layer():
    placed = [module for layer in LAYERS for module in layer]
    assert sorted(placed) == sorted(m for m in MODULES if m.split('.')[0] not in TOP)


@pytest.mark.parametrize('height', range(len(LAYERS)))
def test_imports_point_down(height):
    below = {module for layer in LAYERS[:height] for module in layer}
    for module in LAYERS[height]:
        assert own(module) - below == set(), module


def test_no_module_imports_itself_by_way_of_others():
    TopologicalSorter({module: own(module) for module in MODULES}).prepare()


@pytest.mark.parametrize('module', [m for m in MODULES if m.split('.')[0] == 'core'])
def test_the_core_stands_on_numpy_scipy_and_the_standard_library_alone(module):
    assert others(module) <= {'numpy', 'scipy'} | OPTIONAL.get(module, set())


def test_only_nodes_speak_to_ros_and_fewer_still_handle_messages():
    assert {m for m in MODULES if any(map(is_ros, others(m)))} <= SPEAKS_ROS
    assert {m for m in MODULES if any(map(carries_messages, others(m)))} <= HANDLES_MESSAGES


@pytest.mark.parametrize('part', ['core', 'config'])
def test_what_needs_no_ros_is_imported_where_there_is_none(part):
    names = [f'pif_ros.{module}' for module in MODULES if module.split('.')[0] == part]
    code = f"""
import importlib, sys
sys.path.insert(0, {str(ROOT)!r})
class NoRos:
    def find_spec(self, name, path=None, target=None):
        if name.split('.')[0].startswith(('rcl', 'ros')) or name.split('.')[0].endswith(
                ('_msgs', '_srvs', '_interfaces')):
            raise ModuleNotFoundError(name)
sys.meta_path.insert(0, NoRos())
try:
    import rclpy
except ModuleNotFoundError:
    print(len([importlib.import_module(name) for name in {names}]))
"""
    done = subprocess.run([sys.executable, '-c', code], capture_output=True, text=True)
    assert (done.stdout.strip(), done.stderr) == (str(len(names)), '')
