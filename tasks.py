#!/usr/bin/env python3
"""
Do the jobs of this package on a machine with Python 3.10 or newer, with or without ROS 2 Jazzy.

    python3 tasks.py demo        find a robot by radio, on a real recording; or: demo --odometry
    python3 tasks.py reproduce   run the papers' examples: --all --out DIR, or --list
    python3 tasks.py test        run the tests
    python3 tasks.py prove       show what the node survives, in hours: or NAME, --share 0.01
    python3 tasks.py lint        run ament_flake8, ament_pep257 and mypy
    python3 tasks.py benchmark   measure the speed
    python3 tasks.py clean       remove all that these jobs and colcon have made

Further arguments go to the job: python3 tasks.py test -k grid

What a job needs is installed into a virtual environment, .venv, and nowhere else.  A sourced ROS
is used as it is; where there is none, its wheels come from PyPI, for x86-64 Linux.
"""

import hashlib
import importlib.util
import os
from pathlib import Path
import shutil
import subprocess
import sys
import tempfile

ROOT = Path(__file__).resolve().parent
BASE_PYTHON = os.path.realpath(sys.executable)  # outside any environment that is active here


def demo(arguments):
    run(environment() / 'python', '-m', 'pif_ros.plaza.demo', '--out', 'demo', *arguments)


def reproduce(arguments):
    run(environment() / 'reproduce', *arguments)


def test(arguments):
    # one process for each core, and all of a file in the same
    run(environment() / 'python', '-m', 'pytest', '-n', 'auto', '--dist', 'loadfile', *arguments,
        ROS_PYTHON_CHECK_FIELDS='1')


def prove(arguments):
    run(environment('prove') / 'python', '-m', 'proofs', *arguments)


def lint(arguments):
    tools = environment('lint')
    code = ['pif_ros', 'test', 'benchmarks', 'proofs', 'launch', 'setup.py', 'tasks.py']
    run(tools / 'ament_flake8', *code)
    run(tools / 'ament_pep257', *code)
    run(tools / 'python', '-m', 'mypy', *arguments)


def benchmark(arguments):
    tools = environment('benchmark', folder='.venv-benchmark')  # apart, since it pins numpy
    run(tools / 'python', '-m', 'benchmarks', *arguments)


def clean(_):
    made = ['.venv', '.venv-benchmark', 'demo', 'papers', 'build', 'install', 'log',
            'pif_ros.egg-info', '.hypothesis', '.mypy_cache', '.pytest_cache']
    for name in made:
        shutil.rmtree(ROOT / name, ignore_errors=True)


def environment(*more_extras, folder='.venv'):
    """
    Make a virtual environment hold this checkout and what its jobs need; return its programs.

    What is in order is kept; what was made for another Python, ROS or setup.py is made anew.
    """
    sourced = ros_is_sourced()
    extras = ['plot,test' if sourced else 'ros,plot,test', *more_extras]
    # gtsam is there for the recording in its data alone, and what it requires would be in the way.
    wanted = ['--no-deps gtsam', *(f'--editable .[{extra}]' for extra in extras)]

    # The stamp's first line says what all was made for, each further one what was installed since.
    stamp = ROOT / folder / 'installed'
    setup = hashlib.sha256((ROOT / 'setup.py').read_bytes()).hexdigest()
    made_for = repr([str(ROOT), BASE_PYTHON, sys.version, sourced, setup])
    lines = stamp.read_text().splitlines() if stamp.exists() else []
    if lines[:1] != [made_for]:
        if not importlib.util.find_spec('ensurepip'):
            sys.exit('venv is missing; on Debian and Ubuntu: sudo apt install python3-venv')
        if not sourced and os.uname().machine != 'x86_64':
            sys.exit('No ROS is sourced, and its wheels are for x86-64 Linux: source ROS 2 Jazzy.')
        say(f'making {folder} for {BASE_PYTHON}, {"with" if sourced else "without"} its ROS')
        options = ['--system-site-packages'] if sourced else []
        run(BASE_PYTHON, '-m', 'venv', '--clear', *options, folder)
        lines = [made_for]

    for what in wanted:
        if what not in lines:
            say('pip install ' + what)
            install(ROOT / folder / 'bin' / 'python', *what.split())
            lines.append(what)
            stamp.write_text('\n'.join(lines))
    return ROOT / folder / 'bin'


def ros_is_sourced():
    """Say whether rclpy is here already; stop where it is here but made for another Python."""
    probe = subprocess.run([BASE_PYTHON, '-c', 'import rclpy'], env=child_environment(),
                           capture_output=True, text=True)
    if probe.returncode and "No module named 'rclpy'" not in probe.stderr:
        sys.exit(f'The ROS that is sourced does not load in {BASE_PYTHON}: start this with the '
                 "system's Python, /usr/bin/python3, or from a shell in which no ROS is sourced.")
    return probe.returncode == 0


def install(python, *what):
    """Run pip, showing its latest line on a terminal, and all of its last lines if it fails."""
    command = [python, '-m', 'pip', '--disable-pip-version-check', '--no-input', 'install',
               '--progress-bar', 'off', *what]
    lines = []
    with subprocess.Popen(command, cwd=ROOT, env=child_environment(), text=True,
                          stdout=subprocess.PIPE, stderr=subprocess.STDOUT) as pip:
        for line in pip.stdout:
            lines.append(line)
            if sys.stdout.isatty():
                print('\r\033[K  ' + line.strip()[:76], end='', flush=True)
    if sys.stdout.isatty():
        print('\r\033[K', end='', flush=True)
    if pip.returncode:
        sys.exit(''.join(lines[-20:]) + 'pip could not install ' + ' '.join(what))


def run(*command, **variables):
    """Run a command in the checkout; end with its status where it fails."""
    with tempfile.TemporaryDirectory() as log_folder:
        env = child_environment(ROS_LOG_DIR=log_folder, **variables)
        status = subprocess.call([str(word) for word in command], cwd=ROOT, env=env)
    if status:
        sys.exit(status)


def child_environment(**variables):
    """Keep ROS traffic on this machine, in a domain of its own unless one is asked for."""
    env = {'ROS_DOMAIN_ID': str(1 + os.getpid() % 101), **os.environ, **variables}
    env['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'
    if env.pop('_ROS_WHEELS_BOOTSTRAP_COMPLETE', None):  # the libraries of an active environment
        env.pop('LD_LIBRARY_PATH', None)
    return env


def say(text):
    print('==>', text, flush=True)


TASKS = {task.__name__: task for task in (demo, reproduce, test, prove, lint, benchmark, clean)}

if __name__ == '__main__':
    if sys.version_info < (3, 10):
        sys.exit('Python 3.10 or newer is needed, and this is %d.%d.' % sys.version_info[:2])
    if len(sys.argv) < 2 or sys.argv[1] not in TASKS:
        sys.exit(__doc__.strip())
    try:
        TASKS[sys.argv[1]](sys.argv[2:])
    except KeyboardInterrupt:
        sys.exit(130)
