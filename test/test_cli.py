# Copyright 2026 The stri_mapping authors
# SPDX-License-Identifier: Apache-2.0
"""The front door: exit codes, one-line errors, quick help."""

from __future__ import annotations

import subprocess
import sys
from types import SimpleNamespace

import pytest

from stri_mapping import __version__, cli
from stri_mapping.errors import BagError, UsageError

HEAVY = ('numpy', 'scipy', 'numba', 'matplotlib', 'rosbags', 'rich', 'rclpy', 'trimesh')


def failing(monkeypatch: pytest.MonkeyPatch, error: BaseException) -> int:
    """Return the exit code of a command that raises."""
    def run(args: object) -> int:
        raise error

    parsed = SimpleNamespace(run=run, command='map')
    monkeypatch.setattr(cli, 'make_parser', lambda _: SimpleNamespace(
        parse_args=lambda arguments: parsed))
    return cli.main(['map'])


@pytest.mark.parametrize('error, code', [
    (UsageError('no such option'), 2), (BagError('a.mcap: broken'), 1), (KeyboardInterrupt(), 130),
])
def test_errors_become_exit_codes_and_one_line(error, code, monkeypatch, capsys):
    assert failing(monkeypatch, error) == code
    lines = capsys.readouterr().err.splitlines()
    assert lines == [f'stri-mapping map: {error or "interrupted"}' if str(error)
                     else 'stri-mapping map: interrupted']


def test_a_bug_is_not_hidden(monkeypatch):
    with pytest.raises(ZeroDivisionError):
        failing(monkeypatch, ZeroDivisionError())


def test_help_names_every_command_and_imports_nothing_heavy():
    code = ('import sys; from stri_mapping import cli; text = cli.make_parser().format_help(); '
            f'print(text); print([m for m in {HEAVY} if m in sys.modules])')
    done = subprocess.run([sys.executable, '-c', code], capture_output=True, text=True, check=True)
    for name in ('evaluate', 'map', 'play', 'run', 'simulate'):
        assert f'\n    {name} ' in done.stdout
    assert done.stdout.splitlines()[-1] == '[]'


def test_a_command_loads_no_other_command():
    code = ('import sys; from stri_mapping import cli; cli.make_parser(["play"]); '
            'print([m for m in sys.modules if m.startswith("stri_mapping.commands.")])')
    done = subprocess.run([sys.executable, '-c', code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "['stri_mapping.commands.play']"


@pytest.mark.parametrize('arguments', [
    [], ['fly'], ['play'], ['record'], ['repair'], ['map'], ['run', '--bag', 'x', '--rate', '-1'],
    ['run', '--bag', 'x', '--simulate', 'street'],
    ['play', 'x', '--rate', 'nan'], ['play', 'x', '--rate', 'fast'],
])
def test_wrong_usage_is_exit_code_2(arguments, capsys):
    with pytest.raises(SystemExit) as stopped:
        cli.main(arguments)
    assert stopped.value.code == 2
    assert 'Traceback' not in capsys.readouterr().err


@pytest.mark.parametrize('name', ['evaluate', 'map', 'play', 'run', 'simulate'])
def test_every_command_explains_itself(name, capsys):
    with pytest.raises(SystemExit) as stopped:
        cli.main([name, '--help'])
    assert stopped.value.code == 0
    assert f'usage: stri-mapping {name}' in capsys.readouterr().out


def test_version(capsys):
    with pytest.raises(SystemExit):
        cli.main(['--version'])
    assert capsys.readouterr().out.strip() == f'stri-mapping {__version__}'


@pytest.mark.parametrize('command', [['run', '--bag'], ['play']])
def test_without_ros_the_live_commands_say_what_to_install(command, monkeypatch, capsys):
    monkeypatch.setattr('importlib.util.find_spec', lambda name: None)
    assert cli.main([*command, 'nowhere']) == 2
    error = capsys.readouterr().err
    assert error.count('\n') == 1
    assert 'stri_mapping[ros]' in error
