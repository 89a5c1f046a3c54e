"""What is installed is what the package says it is."""

import ast
from importlib.metadata import Distribution
import os
from pathlib import Path
import re
import runpy
import subprocess
import sys
from xml.etree import ElementTree

import pif_ros
import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGE_XML = ElementTree.parse(ROOT / 'package.xml').getroot()

# Modules whose rosdep key is not their own name.
ROSDEP_KEYS = {
    'hypothesis': 'python3-hypothesis',
    'joblib': 'python3-joblib',
    'matplotlib': 'python3-matplotlib',
    'numpy': 'python3-numpy',
    'pytest': 'python3-pytest',
    'scipy': 'python3-scipy',
    'tqdm': 'python3-tqdm',
    'yaml': 'python3-yaml',
}

# Imported only where they are asked for or found; all but numba, which brings llvmlite, have no
# rosdep key: pip brings them.
OPTIONAL = {'dask', 'distributed', 'filterpy', 'llvmlite', 'numba', 'pywt'}


@pytest.fixture(scope='module')
def prefix(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Install the checkout as colcon does, and return where."""
    folder = tmp_path_factory.mktemp('install')
    command = ['setup.py', '-q', 'egg_info', '--egg-base', folder,
               'build', '--build-base', folder / 'build',
               'install', '--prefix', folder / 'prefix', '--single-version-externally-managed',
               '--record', folder / 'record']
    subprocess.run([sys.executable, *map(str, command)], cwd=ROOT, check=True)
    return folder / 'prefix'


@pytest.fixture(scope='module')
def distribution(prefix: Path) -> Distribution:
    """Return what the installed package says of itself."""
    [metadata] = prefix.rglob('pif_ros-*.egg-info')
    return Distribution.at(metadata)


def imports(*folders: str) -> set[str]:
    """Return the rosdep keys of the third-party packages that the code there imports."""
    files = [file for folder in folders for file in (ROOT / folder).rglob('*.py')]
    names = set()
    for node in (node for file in files for node in ast.walk(ast.parse(file.read_text()))):
        if isinstance(node, ast.Import):
            names |= {alias.name.split('.')[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and not node.level:
            names.add(node.module.split('.')[0])
    own = {'pif_ros', 'proofs', 'test'} | {file.stem for file in (ROOT / 'test').rglob('*.py')}
    return {ROSDEP_KEYS.get(name, name)
            for name in names - own - sys.stdlib_module_names - OPTIONAL}


def depends(kind: str) -> set[str]:
    return {element.text for element in PACKAGE_XML.iter(kind)}


def test_package_xml_names_what_the_package_imports_and_nothing_else():
    assert depends('exec_depend') == imports('pif_ros', 'launch')


def test_package_xml_names_what_the_tests_import():
    assert imports('test') <= depends('exec_depend') | depends('test_depend')


def test_the_version_is_the_same_everywhere(distribution):
    assert distribution.version == pif_ros.__version__ == PACKAGE_XML.findtext('version')
    assert distribution.version in (ROOT / 'CHANGELOG.rst').read_text()


def test_console_scripts_are_installed_where_ros_looks_for_them_and_load(prefix, distribution):
    scripts = distribution.entry_points.select(group='console_scripts')
    assert scripts.names == {'filter_bank', 'filter_node', 'plaza_player', 'plaza_demo',
                             'reproduce', 'simulate'}
    for script in scripts:
        assert callable(script.load())
        assert os.access(prefix / 'lib' / 'pif_ros' / script.name, os.X_OK)


def test_the_share_folder_is_complete(prefix):
    share = prefix / 'share' / 'pif_ros'
    installed = {file.relative_to(share) for file in share.rglob('*') if file.is_file()}
    sources = [ROOT / 'package.xml', *ROOT.glob('config/*.yaml'), *ROOT.glob('launch/*.launch.py')]
    assert installed == {file.relative_to(ROOT) for file in sources}
    assert (prefix / 'share/ament_index/resource_index/packages/pif_ros').is_file()


def test_every_module_is_installed_and_its_types_are_declared(prefix):
    [package] = prefix.rglob('site-packages/pif_ros')
    source = ROOT / 'pif_ros'
    installed = {file.relative_to(package) for file in package.rglob('*.py')}
    assert installed == {file.relative_to(source) for file in source.rglob('*.py')}
    assert (package / 'py.typed').is_file()


@pytest.mark.parametrize('start', [
    pytest.param('import os; os.environ["AMENT_PREFIX_PATH"] = ', id='of a sourced workspace'),
    pytest.param('import sys; sys.prefix = ', id='of the Python environment'),
])
def test_an_installed_package_finds_its_configuration_in_the_share_folder(prefix, start, tmp_path):
    [package] = prefix.rglob('site-packages/pif_ros')
    names = sorted(str(file.relative_to(ROOT)) for file in ROOT.glob('config/*.yaml'))
    code = (f'{start} {str(prefix)!r}; from pif_ros.share import find; '
            f'print(*map(find, {names}), sep="\\n")')
    env = {**os.environ, 'PYTHONPATH': str(package.parent), 'AMENT_PREFIX_PATH': ''}
    found = subprocess.run([sys.executable, '-c', code], cwd=tmp_path, env=env,
                           check=True, capture_output=True, text=True).stdout.split()
    assert names and found == [str(prefix / 'share' / 'pif_ros' / name) for name in names]


def test_make_has_a_shortcut_to_every_task():
    [targets] = re.findall(r'^(\w[\w ]*):$', (ROOT / 'Makefile').read_text(), re.M)
    assert set(targets.split()) == set(runpy.run_path(str(ROOT / 'tasks.py'))['TASKS'])


def test_what_the_commands_of_the_readme_make_is_ignored_and_cleaned(monkeypatch):
    made = set(re.findall(r'--out (\w+)', (ROOT / 'README.md').read_text())) - {'DIR'}
    removed = []
    monkeypatch.setattr('shutil.rmtree', lambda path, **_: removed.append(Path(path).name))
    runpy.run_path(str(ROOT / 'tasks.py'))['TASKS']['clean']([])
    assert made and made <= set(removed)
    assert {f'/{name}/' for name in made} <= set((ROOT / '.gitignore').read_text().split())
