"""Working ahead changes no estimate, whatever comes next."""

from hypothesis import given
from hypothesis import strategies as st
from properties import PROPERTY

from agents.estimation.estimator import Estimate, RelativeEstimator
from bus.messages import Detector, Estimator, Limits
from bus.ticks import Look

DT = 0.05
steps = st.lists(
    st.tuples(
        st.sampled_from([1, 1, 1, 2, 40]),
        st.sampled_from(["seen", "missed", "gross"]),
        st.booleans(),
    ),
    max_size=40,
)


def _fly(course: list[tuple[int, str, bool]], *, ahead: bool) -> list[Estimate | None]:
    estimator = RelativeEstimator(
        detector=Detector(noise=0.1, period=DT),
        target=Limits(max_speed=0.2, max_acceleration=0.1),
        dt=DT,
        settings=Estimator(patience=3),
    )
    tick, estimates = 0, []
    for elapsed, what, works_ahead in course:
        tick += elapsed
        place = (1.0 + 0.01 * tick, 0.1 * (tick % 3)) if what == "seen" else (30.0, 30.0)
        looks = () if what == "missed" else (Look(tick, *place),)
        estimates.append(estimator.update(tick=tick, own_position=(20.0, 20.0), looks=looks))
        if ahead and works_ahead:
            estimator.prepare()
            estimator.prepare()
    return estimates


@given(steps)
@PROPERTY
def test_an_estimator_that_works_ahead_estimates_the_same_bits(
    course: list[tuple[int, str, bool]],
) -> None:
    assert _fly(course, ahead=True) == _fly(course, ahead=False)
