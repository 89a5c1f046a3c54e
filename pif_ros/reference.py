"""The README's tables, made from the tables in the code: python -m pif_ros.reference README.md."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
import dataclasses
import inspect
from pathlib import Path
import re
import sys
from typing import Any

from pif_ros import interface
from pif_ros.config import specifications
from pif_ros.core.systems import System, SYSTEMS
from pif_ros.scenario import Settings


def tables() -> Mapping[str, str]:
    """Return every generated table of the README by the name of its place."""
    return {'topics': _topics(), 'services': _endpoints(interface.SERVICES),
            'parameters': _parameters(), 'systems': _systems(), 'simulate': _simulate()}


def filled(text: str) -> str:
    """Return a text with the tables put between their marks; KeyError for an unknown one."""
    made = tables()
    return re.sub(r'(<!-- table: (\w+) -->\n).*?(<!-- end -->)',
                  lambda match: f'{match[1]}{made[match[2]]}\n{match[3]}', text, flags=re.DOTALL)


def _topics() -> str:
    sources = '| subscribed | `measurements.NAME.topic` | any installed type | a measurement |'
    control = ('| subscribed | `control.topic` | any installed type | what drives a model with '
               'inputs; its stamp is the start of the interval for which it holds |')
    rows = [sources, control] + [
        f'| {way} | `{out.name}` | {out.type_name} | {out.says} |'
        for way, endpoints in (('subscribed', interface.SUBSCRIPTIONS),
                               ('published', interface.PUBLICATIONS)) for out in endpoints]
    return _table(('', 'topic', 'type', 'what and when'), rows)


def _endpoints(endpoints: Iterable[interface.Endpoint]) -> str:
    return _table(('service', 'type', 'what it does'), [
        f'| `{service.name}` | {service.type_name} | {service.says} |' for service in endpoints])


def _parameters() -> str:
    rows = []
    for name, spec in specifications(('NAME',)).items():
        rows.append(_parameter(name, spec))
        if name.endswith('.sensor'):
            rows.append('| `measurements.NAME.params.*` | | numbers | the constants of that '
                        'sensor |')
        if name == 'model.name':
            rows.append('| `model.params.*` | | numbers | the constants of that model |')
    return _table(('parameter', 'default', 'expected', 'what it is'), rows)


def _simulate() -> str:
    return _table(('setting', 'default', 'expected', 'what it is'), [
        _parameter(spec.name, spec) for spec in dataclasses.fields(Settings)])


def _parameter(name: str, spec: Any) -> str:
    meta = spec.metadata
    says = meta['says'] + (f' [{meta["unit"]}]' if meta['unit'] else '')
    says += '; may be set while running' if meta['live'] else ''
    return (f'| `{name}` | `{_shown(spec.default)}` | {_cell(meta["kind"].wanted)} | '
            f'{says} |')


def _systems() -> str:
    rows = []
    for name, maker in SYSTEMS.items():
        system = maker()
        says = (inspect.getdoc(maker) or '').splitlines()[0]
        rows.append(f'| `{name}` | {_cell(says)} | {_constants(maker)} | '
                    f'{", ".join(_sensor(system, sensor) for sensor in system.sensors)} |')
    return _table(('`model.name`', 'what it is', '`model.params`', 'sensors and their params'),
                  rows)


def _sensor(system: System, name: str) -> str:
    constants = _constants(system.sensors[name])
    return f'`{name}`' + (f' ({constants})' if constants else '')


def _constants(maker: Any) -> str:
    return ', '.join(f'{name} = {_shown(spec.default)}' if spec.default is not spec.empty else name
                     for name, spec in inspect.signature(maker).parameters.items())


def _shown(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, tuple):
        return f'[{", ".join(map(_shown, value))}]'
    return "''" if value == '' else str(value)


def _cell(text: str) -> str:
    return text.replace('|', '\\|')


def _table(head: tuple[str, ...], rows: Iterable[str]) -> str:
    return '\n'.join([f'| {" | ".join(head)} |', '|' + '---|' * len(head), *rows])


def main() -> int:
    """Fill the tables of the files that are named."""
    for name in sys.argv[1:]:
        path = Path(name)
        path.write_text(filled(path.read_text(encoding='utf-8')), encoding='utf-8')
    return 0


if __name__ == '__main__':
    sys.exit(main())
