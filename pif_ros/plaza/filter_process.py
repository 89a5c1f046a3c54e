"""The filter node in a process of its own."""

from __future__ import annotations

from pathlib import Path
import re
import signal
import subprocess
import sys

COMMAND = (sys.executable, '-m', 'pif_ros.node')
_PATIENCE = 10.0
_ACCOUNT = re.compile(r'(\w+): (\d+ received[^;\n]*)')


class FilterFailed(RuntimeError):
    """The filter node did not do its part; the message says what, in one line."""


class FilterProcess:
    """A running filter_node, whose output goes into a file."""

    def __init__(self, params_file: Path, log: Path) -> None:
        """Start the node with a parameter file, to publish every density if someone listens."""
        self._log = log
        command = [*COMMAND, '--ros-args', '--params-file', str(params_file),
                   '-p', 'use_sim_time:=true', '-p', f'density.rate:={1e9}']
        with log.open('wb') as output:
            self._process = subprocess.Popen(command, stdout=output, stderr=subprocess.STDOUT)

    def check(self) -> None:
        """Raise FilterFailed where the node has ended by itself."""
        status = self._process.poll()
        if status is not None:
            raise FilterFailed(f'the filter node ended by itself with status {status}')

    def end(self) -> None:
        """End the node by SIGINT; FilterFailed where it does not end, or not with status 0."""
        self._process.send_signal(signal.SIGINT)
        try:
            status = self._process.wait(_PATIENCE)
        except subprocess.TimeoutExpired:
            raise FilterFailed(
                f'the filter node still runs {_PATIENCE:g} s after SIGINT') from None
        if status != 0:
            raise FilterFailed(f'the filter node ended with status {status} after SIGINT')

    def output(self) -> str:
        """Return what the node has written so far."""
        return self._log.read_text(errors='replace').rstrip()

    def kill(self) -> None:
        """Make sure that the node does not outlive this process."""
        if self._process.poll() is None:
            self._process.kill()
            self._process.wait()


def accounts(output: str) -> dict[str, dict[str, int]]:
    """
    Return what became of 'ranges' and 'controls', as the node's last words tell it.

    The ranges of all beacons are counted together; what was not received at all is not named.
    """
    result: dict[str, dict[str, int]] = {}
    for source, account in _ACCOUNT.findall(output.rpartition('stopped; ')[2]):
        total = result.setdefault('controls' if source == 'control' else 'ranges', {})
        for count, what in re.findall(r'(\d+) (received|accepted|rejected|dropped)', account):
            total[what] = total.get(what, 0) + int(count)
    return result
