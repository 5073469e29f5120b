"""Imports of a process: no compiler where nothing is computed."""

import sys

import pytest

from processes import ran


@pytest.mark.parametrize("words", ["--help", "run --help", "drive --help", "credentials --help"])
def test_a_command_that_computes_nothing_imports_no_numba(words: str) -> None:
    code = (
        f"import sys; sys.argv = ['outrider', *{words.split()}]\n"
        "from outrider.cli.main import run_command_line\n"
        "print(run_command_line(), 'numba' in sys.modules)"
    )
    done = ran([sys.executable, "-W", "error", "-c", code])
    assert done.stdout.split()[-2:] == ["0", "False"], done.stderr
