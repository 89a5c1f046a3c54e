"""The README says what the code says."""

from pathlib import Path
import re

from pif_ros.reference import filled, tables

README = Path(__file__).parent.parent / 'README.md'


def test_the_tables_of_the_readme_are_those_of_the_code():
    text = README.read_text(encoding='utf-8')
    assert set(re.findall(r'<!-- table: (\w+) -->', text)) == set(tables())
    assert text == filled(text)


def test_a_parameter_that_changes_makes_the_readme_differ():
    text = README.read_text(encoding='utf-8')
    assert filled(text.replace('`kernel.time_step` | `0.01`', '`kernel.time_step` | `0.02`')) \
        == text
