"""What a node needs to be a good process."""

import os
import signal
import subprocess
import sys
from textwrap import dedent

from pif_ros.process import explain, failed, logs_to_stdout, params_files, Signals, strangers
import pytest
import rclpy
from rclpy.context import Context


@pytest.fixture
def signals():
    """Take the signals over, and give them back."""
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    yield Signals()
    for number, handler in before.items():
        signal.signal(number, handler)


def test_no_signal_is_no_reason_to_stop(signals):
    assert not signals()


@pytest.mark.parametrize('numbers', [
    [signal.SIGINT], [signal.SIGTERM], [signal.SIGINT] * 3, [signal.SIGTERM, signal.SIGINT]],
    ids=lambda numbers: '+'.join(number.name for number in numbers))
def test_any_number_of_signals_is_one_wish_to_stop(signals, numbers):
    for number in numbers:
        os.kill(os.getpid(), number)
    assert signals() and signals()


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM])
def test_a_signal_while_the_interpreter_ends_changes_nothing(number):
    # what a module holds is let go of when Python has already forgotten its own handlers
    late = dedent(f"""
        import os, signal
        from pif_ros.process import Signals
        stopped = Signals()
        class Held:
            def __del__(self, end=os.kill, me=os.getpid(), tell=os.write):
                tell(1, b'ending')
                end(me, {int(number)})
                tell(1, b', ended')
        held = Held()
        """)
    ended = subprocess.run([sys.executable, '-c', late], capture_output=True, timeout=60)
    assert (ended.returncode, ended.stdout, ended.stderr) == (0, b'ending, ended', b'')


def test_logs_go_to_stdout_unless_the_user_said_otherwise(monkeypatch):
    monkeypatch.delenv('RCUTILS_LOGGING_USE_STDOUT', raising=False)
    monkeypatch.setenv('RCUTILS_LOGGING_BUFFERED_STREAM', '1')
    logs_to_stdout()
    assert os.environ['RCUTILS_LOGGING_USE_STDOUT'] == '1'
    assert os.environ['RCUTILS_LOGGING_BUFFERED_STREAM'] == '1'


def test_a_failure_is_one_line_on_stderr_and_a_status(capsys):
    assert failed('filter_node', 'a reason\n  with lines\n', 2) == 2
    assert capsys.readouterr() == ('', 'filter_node: a reason with lines\n')


def test_parameter_files_are_found_among_the_arguments():
    arguments = ['node', '--ros-args', '--params-file', 'a.yaml', '-p', 'x:=1', '--params-file',
                 'b.yaml']
    assert params_files(arguments) == ['a.yaml', 'b.yaml']
    assert params_files(['node', '--params-file']) == []


NODE = '/**:\n  ros__parameters:\n'


def refused(path, *more):
    """Return how a parameter file is explained that ROS does not take."""
    arguments = ['filter_node', '--ros-args', '--params-file', str(path), *more]
    with pytest.raises(Exception) as fault:  # noqa: B017  RCLError has no public name
        rclpy.init(context=Context(), args=arguments)
    line = explain(fault.value, arguments)
    assert '\n' not in line and '/project/src' not in line
    return line


@pytest.mark.parametrize(('text', 'words'), [
    (NODE + '    grid: {lower: [-6, -6.5]}\n', ['grid.lower: ', '[-6, -6.5]', 'one type']),
    (NODE + '    grid.lower: [-6.5, -6]\n', ['grid.lower: ', '[-6.5, -6]', 'one type']),
    (NODE + '    grid: {periodic: [true, 0]}\n', ['grid.periodic: ', '[True, 0]']),
    (NODE + '    grid: {lower: [[-6.0], [-6.0]]}\n', ['grid.lower: ', 'flat list', '[[-6.0]']),
    (NODE + '    pose: {axes: [x, y]}\n', ["'y'", 'quotes', '{path}']),
    ('filter_node:\n  frame_id: map\n', ['{path}', 'ros__parameters']),
    ('filter_node:\n  ros__parameters:\n   a: 1\n    b: 2\n', ['{path}', 'YAML']),
    ('filter_node:\n\tros__parameters:\n', ['{path}', 'YAML']),
    (b'\xd9: [\x00\x01', ['{path}', 'YAML']),
    ('/**:\n  ros__parameters: &x\n    a: *x\n', ['{path}', 'within itself']),
    (NODE + '    a: 1\n---\n' + NODE + '    a: [1, 1.5]\n', ['a: ', '[1, 1.5]', 'one type']),
], ids=['integer first', 'real first', 'number among booleans', 'nested', 'y is true',
        'no ros__parameters', 'broken', 'tabs', 'binary', 'of itself', 'second document'])
def test_a_file_that_ros_does_not_take_is_explained_in_one_line(tmp_path, text, words):
    path = tmp_path / 'wrong.yaml'
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    line = refused(path)
    for word in words:
        assert word.format(path=path) in line


def test_a_file_that_is_missing_or_a_folder_is_named(tmp_path):
    assert refused(tmp_path / 'no.yaml') == (
        f'{tmp_path}/no.yaml: expected a readable file, got No such file or directory')
    assert refused(tmp_path) == f'{tmp_path}: expected a readable file, got Is a directory'


def test_the_file_that_is_wrong_is_named_among_others(tmp_path):
    right, wrong = tmp_path / 'right.yaml', tmp_path / 'wrong.yaml'
    right.write_text(NODE + '    frame_id: map\n')
    wrong.write_text('frame_id: [\n')
    line = refused(right, '--params-file', str(wrong))
    assert str(wrong) in line and str(right) not in line


def test_an_argument_that_ros_does_not_take_is_explained_in_one_line(tmp_path):
    path = tmp_path / 'right.yaml'
    path.write_text(NODE + '    frame_id: map\n')
    assert '-p' in refused(path, '-p', 'grid.lower=[1.0]')


def test_a_file_for_another_node_is_told_from_one_for_this_node(tmp_path):
    path = tmp_path / 'others.yaml'
    path.write_text('ekf_node:\n  ros__parameters: {a: 1}\n/robot/amcl:\n'
                    '  ros__parameters: {b: 2}\n')
    line = strangers(['--params-file', str(path)], '/filter_node')
    assert '\n' not in line
    for word in ('/filter_node', 'ekf_node', '/robot/amcl', '--params-file'):
        assert word in line


@pytest.mark.parametrize('text', [
    '', '# nothing\n', 'ekf_node'.encode('utf-16'),
    '/**:\n  ros__parameters: {use_sim_time: true}\n',
    'ekf_node:\n  ros__parameters: {a: 1}\n/**:\n  ros__parameters: {use_sim_time: true}\n'])
def test_a_file_that_is_empty_or_for_every_node_is_no_strangers(tmp_path, text):
    path = tmp_path / 'some.yaml'
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    assert strangers(['--params-file', str(path)], '/filter_node') is None


def test_each_document_of_a_file_counts(tmp_path):
    path = tmp_path / 'two.yaml'
    path.write_text('/other:\n  ros__parameters: {a: 1}\n---\n/another:\n'
                    '  ros__parameters: {a: 1}\n', encoding='utf-8')
    arguments = ['node', '--ros-args', '--params-file', str(path)]
    context = Context()
    rclpy.init(context=context, args=arguments)
    context.try_shutdown()
    assert strangers(arguments, '/another') is None
    assert strangers(arguments, '/filter_node').endswith(' got some for /another, /other only')


def test_what_cannot_be_read_here_is_no_strangers(tmp_path):
    path = tmp_path / 'itself.yaml'
    path.write_text('/other: &x\n  ros__parameters: *x\n', encoding='utf-8')
    assert strangers(['--params-file', str(path)], '/filter_node') is None


def test_without_a_parameter_file_there_are_no_strangers():
    assert strangers(['--ros-args', '-p', 'frame_id:=map'], '/filter_node') is None


def test_a_file_for_this_node_is_no_strangers_even_if_it_says_little(tmp_path):
    path = tmp_path / 'only.yaml'
    path.write_text('/filter_node: {ros__parameters: {use_sim_time: false}}\n', encoding='utf-8')
    assert strangers(['--params-file', str(path)], '/filter_node') is None
