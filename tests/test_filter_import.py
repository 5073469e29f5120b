"""The imports of a process: filterpy's filter without its rest, to the same bits; no compiler where nothing flies."""

import sys

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from processes import ran
from properties import PROPERTY

from agents.estimation.kalman import AxisFilter, KalmanFilter
from agents.estimation.motion_model import motion


def _printed(code: str) -> str:
    done = ran([sys.executable, "-W", "error", "-c", code])
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


def test_a_uav_pilot_loads_none_of_the_packages_that_its_filter_does_without():
    heavy = (
        "{'scipy.linalg.blas', 'numpy.f2py', 'scipy.stats', 'filterpy.kalman.EKF', 'matplotlib'}"
    )
    code = (
        "import sys\nfrom outrider.running.flying import run\n"
        "from sim.scenario.loading import load_scenario\n"
        "run(load_scenario('escort', overrides=['duration=1.0']))\n"
        f"print('agents.uav' in sys.modules, {heavy} & set(sys.modules))"
    )
    assert _printed(code) == "True set()"


def test_checking_a_scenario_loads_no_compiler():
    told = _printed(
        "import sys; sys.argv = ['outrider', 'check', 'escort', '--set', 'law.name=certified']\n"
        "from outrider.cli.main import run_command_line\n"
        "print(run_command_line(), 'numba' in sys.modules)"
    )
    assert told.endswith("0 False")
    assert "can be flown" in told


def test_filterpy_is_whole_for_whoever_imports_it_after_a_pilot_or_before():
    whole = (
        "from agents.estimation.kalman import KalmanFilter as ours\n"
        "from filterpy.kalman import KalmanFilter, UnscentedKalmanFilter, update\n"
        "from filterpy.common import Q_discrete_white_noise, Saver\n"
        "import filterpy\n"
        "assert ours is KalmanFilter\n"
        "assert filterpy.stats.logpdf.__module__ == 'filterpy.stats.stats'\n"
        "assert filterpy.__version__ and filterpy.leastsq and filterpy.kalman.EKF\n"
        "print(Q_discrete_white_noise(2).shape, UnscentedKalmanFilter.__name__)\n"
    )
    expected = "(2, 2) UnscentedKalmanFilter"
    assert _printed(whole) == expected
    assert _printed("import filterpy.kalman\n" + whole) == expected


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


def test_the_filter_has_its_likelihood_as_filterpy_computes_it():
    likelihood = (
        "from {} import KalmanFilter\n"
        "f = KalmanFilter(dim_x=1, dim_z=1)\n"
        "f.update(0.5)\n"
        "print(repr(float(f.log_likelihood)), 'likelihood' in repr(f))\n"
    )
    ours = _printed(likelihood.format("agents.estimation.kalman"))
    assert ours == _printed(likelihood.format("filterpy.kalman"))
    assert ours.endswith("True")


@given(st.lists(st.booleans(), min_size=1, max_size=30), st.integers(0, 2**32 - 1))
@PROPERTY
def test_the_filter_without_bookkeeping_has_the_bits_of_filterpys_own(seen, seed) -> None:
    rng = np.random.default_rng(seed)
    F, Q = motion(ticks=1, dt=0.05, deviation=rng.uniform(0.0, 2.0))
    spread, variance = rng.normal(size=(2, 2)), rng.uniform(1e-6, 1.0)
    P, P_prior, P_post, K = spread @ spread.T, np.zeros((2, 2)), np.zeros((2, 2)), np.zeros((2, 1))
    ours = AxisFilter(variance=variance, P=P, P_prior=P_prior, P_post=P_post, K=K)
    theirs = KalmanFilter(dim_x=2, dim_z=1)
    theirs.inv = lambda S: S * (1.0 / (S * S))
    theirs.x, theirs.P = np.array([7.0, 0.1]), P.copy()
    theirs.H, theirs.R = np.eye(1, 2), np.array([[variance]])
    for detected in seen:
        ours.predict(F, Q)
        theirs.predict(F=F, Q=Q)
        P[:] = P_prior
        if detected:
            ours.weigh(P_prior)
            theirs.update(np.array([7.0]))
            assert theirs.K.tobytes() == K.tobytes()
            P[:] = P_post
        assert P.tobytes() == theirs.P.tobytes()
