"""Shared by the tests of the command."""

import pytest

from ikjax import cli


@pytest.fixture
def run(capsys):
    """Exit code, stdout and stderr of a command."""

    def call(*words):
        code = cli.main([str(word) for word in words])
        return code, *capsys.readouterr()

    return call
