"""`gain:NUMBER`: policy that drives a UGV to its goal, `outrider run --driver gain:0.3`."""

from bus.errors import ScenarioError
from bus.policies import PolicyKind

GAIN = PolicyKind(form="NUMBER", ugv="outrider_hover.policy:load_gain")


def load_gain(text, where):
    """Return the policy; `where` names field and value in errors."""
    try:
        gain = float(text)
    except ValueError:
        raise ScenarioError(f"{where}: not a number; allowed: gain:0.3") from None

    def drive(observation, briefing):
        goal = briefing.goals[0] if briefing.goals else observation.position
        (x, y), (v_x, v_y) = observation.position, observation.velocity
        return gain * (goal[0] - x) - v_x, gain * (goal[1] - y) - v_y

    return drive
