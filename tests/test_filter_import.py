"""Imports of a process: no compiler where nothing flies, and SciPy as it is."""

import sys

from processes import ran


def _printed(code: str) -> str:
    done = ran([sys.executable, "-W", "error", "-c", code])
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


def test_checking_a_scenario_loads_no_compiler():
    told = _printed(
        "import sys; sys.argv = ['outrider', 'check', 'escort', '--set', 'law.name=certified']\n"
        "from outrider.cli.main import run_command_line\n"
        "print(run_command_line(), 'numba' in sys.modules)"
    )
    assert told.endswith("0 False")
    assert "can be flown" in told


def test_scipys_algebra_is_whole_for_whoever_imports_it_after_a_kernel_or_before():
    whole = (
        "import sim.models.field\n"
        "import numba, numpy as np\n"
        "import scipy.linalg\n"
        "from scipy.linalg import solve\n"
        "product = numba.njit(lambda a: a @ np.linalg.inv(a))\n"
        "print(solve(np.eye(2), np.ones(2)), scipy.linalg.blas.ddot([1.0], [2.0]), "
        "product(2.0 * np.eye(2)).trace(), scipy.linalg.__doc__.strip()[:3])"
    )
    expected = "[1. 1.] 2.0 2.0 ==="
    assert _printed(whole) == expected
    assert _printed("import scipy.linalg\n" + whole) == expected
