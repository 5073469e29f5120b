"""Every fault of a scenario becomes one line.

The line names file, field, value, cause, and allowed values.
"""

import math
from pathlib import Path
from random import Random

import msgspec
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from bus.errors import ScenarioError
from bus.law_parameters import law_parameters
from bus.messages.scenario import Law
from bus.numbers import above, at_least, at_most, below, exact
from bus.registry import LAWS
from refusals import SHIPPED, SMALL, refusal, written
from sim.engine.briefing import briefing
from sim.scenario import checks
from sim.scenario.checks import CHECKS, check_scenario, scenario_warnings
from sim.scenario.loading import load_scenario
from tabular import rows

ESCORT = load_scenario("escort")


# Refusals: every check has a row with the field, its value and the allowed values

CHECK = {check.__name__: check for check in CHECKS}
BROKEN = [
    (CHECK[check], overrides.split(" & "), field, allowed.replace("{LAWS}", ", ".join(LAWS)))
    for check, overrides, field, allowed in rows(r"""
numbers_are_finite | uav.0.max_speed=1e13 | uav.0.max_speed = 10000000000000.0 | up to 1e+12, or inf
names_are_different | uav.0.name=ugv_0 | ugv.0.name = "ugv_0" | operator, observer, ugv_0
names_are_different | uav.0.name=simulator | uav.0.name = "simulator" | any other than simulator
names_are_different | uav.0.name="a\n" | uav.0.name = "a\n" | lower-case letters
escorts_are_there | uav.0.escorts=ugv_1 | uav.0.escorts = "ugv_1" | ugv_0
grid_divides_area | area.cell=0.3 | area.cell = 0.3 | a divisor of both sides
grid_divides_area | area.cell=80.0 | area.cell = 80.0 | a divisor of both sides
grid_divides_area | area.height=40.1 | area.cell = 0.25 | a divisor of both sides
grid_divides_area | area.cell=0.01 | area.cell = 0.01 | 0.02 m or more
grid_divides_area | area.width=1e7 | area.width = 10000000.0 | up to 1e+06 m
time_is_whole | dt=1.5 | dt = 1.5 | 1e-06 to 1 s
time_is_whole | dt=1e-9 | dt = 1e-09 | 1e-06 to 1 s
time_is_whole | duration=30.02 | duration = 30.02 | multiples of dt = 0.05 s, such as 30
time_is_whole | duration=0.01 | duration = 0.01 | such as 0.05
time_is_whole | duration=500000.05 | duration = 500000.05 | 10,000,000 ticks at most, 500000 s
rates_fit_ticks | detections.rate=7 | detections.rate = 7.0 | 20, 10, 6.666667, ... 1/s
rates_fit_ticks | detections.rate=40 | detections.rate = 40.0 | 20, 10, 6.666667, ... 1/s
rates_fit_ticks | detections.rate=1e-6 | detections.rate = 1e-06 | 20, 10, 6.666667, ... 1/s
sight_is_within_range | visibility.radius=5 | visibility.radius = 5.0 | less than sensor.range = 5 m
points_are_inside | uav.0.position=[40.5, 9] | uav.0.position = [40.5, 9.0] | [0, 40] x [0, 40] m
points_are_inside | ugv.0.goals.1=[1, -1] | ugv.0.goals.1 = [1.0, -1.0] | [0, 40] x [0, 40] m
covered_is_inside | coverage.covered=[{lower=[1, 5], upper=[2, 5]}] | coverage.covered.0.upper.1 = 5.0 | more than 5 m
covered_is_inside | coverage.covered=[{lower=[1, -5], upper=[2, 5]}] | coverage.covered.0.lower.1 = -5.0
| y from 0 to 40 m
covered_is_inside | coverage.covered=[{lower=[1, 1], upper=[2, 5]}, {lower=[1, 1], upper=[41, 5]}]
| coverage.covered.1.upper.0 = 41.0 | x from 0 to 40 m
starts_are_within_bounds | ugv.0.velocity=[0.2, 0.1] | ugv.0.velocity = [0.2, 0.1] | up to ugv.0.max_speed
uav_is_stronger | uav.0.max_speed=0.2 | uav.0.max_speed = 0.2 | above 0.2 m/s
uav_is_stronger | uav.0.max_acceleration=0.1 | uav.0.max_acceleration = 0.1 | above 0.1 m/s²
ugv_is_seen_at_start | uav.0.position=[7, 12.75] | uav.0.position = [7.0, 12.75] | visibility.radius = 4.75 m
wind_is_possible | wind.mean=[0.3, 0.4] & wind.limit=0.4 | wind.mean = [0.3, 0.4] | up to wind.limit = 0.4 m/s²
inner_loops_resist | wind.mean=[1, 0] | uav.0.tracking.reserve = 0.5 | m/s² or more
inner_loops_resist | uav.0.position_error=0.1 & uav.0.tracking.velocity_gain=40 | uav.0.tracking.velocity_gain = 40.0
| less than 40 1/s
inner_loops_resist | uav.0.position_error=0.1 & uav.0.tracking.position_gain=80 | uav.0.tracking.position_gain = 80.0
| less than 2 velocity_gain / dt = 80 1/s²
inner_loops_resist | uav.0.position_error=0.1 & uav.0.tracking.position_gain=1e-9 | uav.0.tracking.position_gain = 1e-09
| larger
names_are_known | law.name=circel | law.name = "circel" | {LAWS}
names_are_known | sensor.model=cone | sensor.model = "cone" | hill, plateau
names_are_known | ugv.0.driver=ghost | ugv.0.driver = "ghost" | waypoints
links_are_possible | links.radio.burst_length=1.0 | links.radio.burst_interval = 0.0 | above 0 s
links_are_possible | links.only=[{vehicle="uav_7"}] | links.only.0.vehicle = "uav_7" | uav_0
commands_act | links.commands.delay=0.6 | command_timeout = 0.5 | 0.6 s or more
own_functions_are_named | ugv.0.driver=policy | custom.policy = "" | module:function
drivers_have_their_task | ugv.0.driver=script | ugv.0.script = [] | velocity
drivers_have_their_task | ugv.0.script=[{time=1,velocity=[0,0.1]},{time=1,velocity=[0,0]}] | ugv.0.script.1.time = 1.0
| increasing times
own_functions_are_named | law.name=weighted | custom.weighting = "" | module:function
own_functions_are_named | law.name=path | custom.path = "" | module:function
own_functions_are_named | custom.path=a..b:c | custom.path = "a..b:c" | module:function
switching_radius_is_positive | visibility.radius=1.05 | uav.0.max_acceleration = 0.3 | above 0.3048 m/s²
switching_radius_is_positive | uav.0.max_speed=inf | uav.0.max_speed = inf | finite speeds
law_parameters_are_possible | law.parameters.speed_gan=2
| law.parameters.speed_gan = 2 | a_c, b_c, c_c, d_c, speed_gain
names_are_known | uav.0.law.name=circel | uav.0.law.name = "circel" | {LAWS}
own_functions_are_named | uav.0.law.name=path | custom.path = "" | module:function
law_parameters_are_possible | uav.0.law.name=lookahead & uav.0.law.parameters.candidates=0
| uav.0.law.parameters.candidates = 0 | 1
reference_speed_is_possible | uav.0.law.name=coverage & law.parameters.reference_speed=0.7
| uav.0.law.parameters.reference_speed = 0.7 | up to uav.0.max_speed = 0.6 m/s
controller_is_stable | uav.0.law.parameters.b_c=-4.0 | uav.0.law.parameters = {a_c = -3.0, b_c = -4.0 | 0 < D A
circle_is_within_sight | uav.0.law.name=circle & law.parameters.circle_radius=5
| uav.0.law.parameters.circle_radius = 5.0 | 4.75 m
law_parameters_are_possible | law.parameters.speed_gain=-2 | law.parameters.speed_gain = -2 | a number > 0.0
reference_speed_is_possible | law.parameters.reference_speed=0.7
| law.parameters.reference_speed = 0.7 | up to uav.0.max_speed = 0.6 m/s
reference_speed_is_possible | uav.0.max_speed=inf & uav.0.max_acceleration=inf | law.parameters.reference_speed
| a number > 0, in m/s
controller_is_stable | law.parameters.b_c=-4.0 | law.parameters = {a_c = -3.0, b_c = -4.0 | 0 < D A - B C < A D
rates_fit_ticks | ground.rate=7 & hazard=[{kind="block",center=[1,1],radius=0.2}] | ground.rate = 7.0 | 20, 10, 6.666667
hazards_are_known | hazard=[{kind="wall",center=[1,1],radius=0.2}] | hazard.0.kind = "wall" | rough, block, find
hazards_are_known | hazard_field=[{kind="blok",count=1,radius=[1,2]}] | hazard_field.0.kind = "blok" | block
hazards_are_known | ground.touch=explode | ground.touch = "explode" | stuck, damage
kinematics_are_possible | ugv.0.kinematics=tank | ugv.0.kinematics = "tank" | point, differential, ackermann
kinematics_are_possible | ugv.0.kinematics=differential | ugv.0.kinematics = "differential" | ugv.0.track above 0
kinematics_are_possible | ugv.0.kinematics=ackermann | ugv.0.kinematics = "ackermann" | ugv.0.max_curvature above 0
kinematics_are_possible | ugv.0.track=0.5 | ugv.0.track = 0.5 | only with differential
kinematics_are_possible | ugv.0.heading=0.5 | ugv.0.heading = 0.5 | only with differential or ackermann
kinematics_are_possible | uav=[] & ugv.0.kinematics=differential & ugv.0.track=0.5 & ugv.0.max_acceleration=inf
| ugv.0.max_acceleration = inf | a finite number of m/s²
kinematics_are_possible | ugv.0.kinematics=differential & ugv.0.track=0.5 & ugv.0.heading=0.0 & ugv.0.velocity=[0.0,0.1]
| ugv.0.velocity = [0.0, 0.1] | along ugv.0.heading = 0, forwards or in reverse
hazards_are_known | ugv.0.caution=blind | ugv.0.caution = "blind" | cautious, bold
tiles_fit_area | ground.tile=41 & hazard=[{kind="block",center=[1,1],radius=0.2}] | ground.tile = 41.0 | 0.25 to 40 m
tiles_fit_area | ground.tile=0.2 & hazard=[{kind="block",center=[1,1],radius=0.2}] | ground.tile = 0.2 | 0.25 to 40 m
tiles_fit_area | ground.tile=0.03 & area.cell=0.025 & hazard=[{kind="block",center=[1,1],radius=0.2}]
| ground.tile = 0.03 | 0.0404 to 40 m
hazards_have_a_shape | hazard=[{kind="block",radius=1}] | hazard.0.center | [x, y] in m, with radius
hazards_have_a_shape | hazard=[{kind="block",center=[1,1]}] | hazard.0.radius | a number > 0, in m
hazards_have_a_shape | hazard=[{kind="block",center=[1,1],radius=1,polygon=[[1,1],[2,1],[2,2]]}]
| hazard.0.polygon = [[1.0, 1.0], [2.0, 1.0], [2.0, 2.0]] | either a disc or a polygon
hazards_have_a_shape | hazard=[{kind="block",center=[1,1],radius=1,speed_share=0.5}] | hazard.0.speed_share = 0.5
| kind rough
hazards_have_a_shape | hazard=[{kind="block",polygon=[[1,1],[2,1]]}] | hazard.0.polygon = [[1.0, 1.0], [2.0, 1.0]]
| three or more
hazards_have_a_shape | hazard=[{kind="block",polygon=[[1,1],[2,1],[1,1]]}]
| hazard.0.polygon = [[1.0, 1.0], [2.0, 1.0], [1.0, 1.0]] | three or more, more than a millimetre apart
hazards_have_a_shape | hazard=[{kind="block",polygon=[[1,1],[2,2],[3,3]]}]
| hazard.0.polygon = [[1.0, 1.0], [2.0, 2.0], [3.0, 3.0]] | not collinear
hazards_have_a_shape | hazard=[{kind="rough",polygon=[[1,1],[2,2],[2,1],[1,2]]}]
| hazard.0.polygon = [[1.0, 1.0], [2.0, 2.0], [2.0, 1.0], [1.0, 2.0]] | in order around the polygon
hazards_lie_in_area | hazard=[{kind="rough",center=[42,1],radius=1}] | hazard.0.center = [42.0, 1.0] | [0, 40] x
hazards_lie_in_area | hazard=[{kind="find",center=[40.5,1],radius=1}] | hazard.0.center = [40.5, 1.0] | [0, 40] x
hazards_lie_in_area | hazard=[{kind="rough",polygon=[[-1,1],[-2,2],[-2,1]]}]
| hazard.0.polygon = [[-1.0, 1.0], [-2.0, 2.0], [-2.0, 1.0]] | [0, 40] x [0, 40] m
starts_and_goals_are_free | hazard=[{kind="rough",center=[1,1],radius=1},{kind="block",center=[20,12.5],radius=1}]
| hazard.1.center = [20.0, 12.5] | away from all starts and goals
routes_are_open | hazard=[{kind="block",polygon=[[9,0],[9.5,0],[9.5,40],[9,40]]}]
| ugv.0.goals.0 = [14.0, 8.0] | adjacent 0.5 m tiles
routes_are_open | ground.tile=2 & hazard=[{kind="block",center=[20.5,13.5],radius=0.1}] | ugv.0.goals.1 = [20.0, 13.0]
| adjacent 2 m tiles
fields_are_possible | hazard_field=[{kind="block",count=1,radius=[2,1]}]
| hazard_field.0.radius = [2.0, 1.0] | smallest
fields_are_possible | hazard_field=[{kind="find",count=1,radius=[1,2],speed_share=1}]
| hazard_field.0.speed_share = 1.0 | rough
fields_are_possible
| hazard_field=[{kind="find",count=9000,radius=[0.1,0.1]},{kind="find",count=9000,radius=[0.1,0.1]}]
| hazard_field.1.count = 9000 | up to 10,000 in total
fields_are_possible | hazard_field=[{kind="rough",count=9000,radius=[1,1]}] | hazard_field.0.count = 9000 | up to 2037
fields_have_room | hazard_field=[{kind="block",count=90,radius=[4,5]}] | hazard_field.0.count = 90 | up to
fields_have_room | hazard_field=[{kind="block",count=9,radius=[1,1],clearance=90}] | hazard_field.0.count = 9
| a smaller clearance
altitudes_are_possible | altitude.law=bets | altitude.law = "bets" | fixed, certified, best
altitudes_are_possible | uav.0.max_climb_rate=2 | uav.0.max_climb_rate = 2.0 | also uav.0.initial_altitude
altitudes_are_possible | uav.0.initial_altitude=14 & uav.0.min_altitude=20 & uav.0.max_altitude=19
| uav.0.min_altitude = 20.0 | up to uav.0.max_altitude = 19 m
altitudes_are_possible | uav.0.initial_altitude=0.9 | uav.0.initial_altitude = 0.9 | 1 to 120 m
altitudes_are_possible | uav.0.initial_altitude=121 | uav.0.initial_altitude = 121.0 | 1 to 120 m
cameras_see | uav.0.initial_altitude=14 & ugv.0.marker_height=120 | ugv.0.marker_height = 120.0
| less than uav.0.min_altitude = 1 m
cameras_see | uav.0.initial_altitude=14 & uav.0.min_altitude=0.2 | uav.0.min_altitude = 0.2 | above 0.5502 m
cameras_see | uav.0.initial_altitude=14 & camera.half_angle=0.01 | uav.0.initial_altitude = 14.0 | above 25.3 m
cameras_see | uav.0.initial_altitude=14 & uav.0.min_altitude=10 & camera.half_angle=0.02
| uav.0.min_altitude = 10.0 | above 12.8 m
uavs_have_an_altitude | building=[{polygon=[[1,1],[2,1],[2,2]],height=3}] | uav.0.initial_altitude | a number in m
uavs_have_an_altitude | building_field=[{block=[4,5],street=4,height=[3,4]}] | uav.0.initial_altitude | a number in m
building_fields_are_possible | uav.0.initial_altitude=14 & building_field=[{block=[5,4],street=4,height=[3,4]}]
| building_field.0.block = [5.0, 4.0] | [smallest, largest] in m
building_fields_are_possible | uav.0.initial_altitude=14 & building_field=[{block=[4,5],street=1,height=[3,4]}]
| building_field.0.street = 1.0 | 1.5 m or more
building_fields_are_possible | uav.0.initial_altitude=14 & ugv.0.building_clearance=1.5
& building_field=[{block=[4,5],street=4,height=[3,4]}] | building_field.0.street = 4.0 | 4.5 m or more
building_fields_are_possible | uav.0.initial_altitude=14 & ugv.0.building_clearance=1.5 & buildings.known=false
& building_field=[{block=[4,5],street=5.9,height=[3,4]}] | building_field.0.street = 5.9 | 6 m or more
building_fields_are_possible | uav.0.initial_altitude=14 & building_field=[{block=[33,40],street=4,height=[3,4]}]
| building_field.0.block = [33.0, 40.0] | fit with two streets into 40 m
building_fields_are_possible | uav.0.initial_altitude=14 & ground.tile=0.25
& building_field=[{block=[0.1,1],street=0.75,height=[3,4]}]
| building_field.0.block = [0.1, 1.0] | 1,000 buildings at most
building_fields_are_possible | uav.0.initial_altitude=14
& building_field=[{block=[0.1,1],street=1.5,height=[3,4]},{block=[0.1,2],street=1.5,height=[3,4]}]
| building_field.1.block = [0.1, 2.0] | 1,000 buildings at most
buildings_have_a_shape | uav.0.initial_altitude=14 & building=[{polygon=[[1,1],[2,2],[2,1],[1,2]],height=3}]
| building.0.polygon = [[1.0, 1.0], [2.0, 2.0], [2.0, 1.0], [1.0, 2.0]] | in order around the polygon
buildings_have_a_shape | uav.0.initial_altitude=14 & building=[{polygon=[[38,1],[41,1],[38,2]],height=3}]
| building.0.polygon = [[38.0, 1.0], [41.0, 1.0], [38.0, 2.0]] | [0, 40] x [0, 40] m
buildings_are_apart | uav.0.initial_altitude=14
& building=[{polygon=[[1,1],[3,1],[3,3]],height=3},{polygon=[[3,1],[5,1],[5,3]],height=3}]
| building.1.polygon = [[3.0, 1.0], [5.0, 1.0], [5.0, 3.0]] | more than a millimetre apart
buildings_are_apart | uav.0.initial_altitude=14
& building=[{polygon=[[1,1],[9,1],[1,7]],height=3},{polygon=[[2,2],[3,2],[2,3]],height=3}]
| building.1.polygon = [[2.0, 2.0], [3.0, 2.0], [2.0, 3.0]] | more than a millimetre apart
buildings_leave_stops_free | uav.0.initial_altitude=14 & building=[{polygon=[[6,7],[9,7],[6,8.5]],height=3}]
| building.0.polygon = [[6.0, 7.0], [9.0, 7.0], [6.0, 8.5]] | away from all starts and goals
buildings_leave_stops_free | uav.0.initial_altitude=14
& building=[{polygon=[[1,1],[2,1],[1,2]],height=3},{polygon=[[19,12],[22,12],[20,14]],height=3}]
| building.1.polygon = [[19.0, 12.0], [22.0, 12.0], [20.0, 14.0]] | away from all starts and goals
buildings_leave_stops_free | uav.0.initial_altitude=14 & building=[{polygon=[[6,8.9],[9,8.9],[6,10]],height=13.5}]
| uav.0.initial_altitude = 14.0 | 14.5 m or more
building_bounds_agree | uav.0.initial_altitude=14 & certificate.max_building_height=2
& building=[{polygon=[[1,1],[2,1],[2,2]],height=3}] | certificate.max_building_height = 2.0 | 3 m or more
routes_are_open | uav.0.initial_altitude=14 & building=[{polygon=[[9,0],[9.5,0],[9.5,40],[9,40]],height=3}]
| ugv.0.goals.0 = [14.0, 8.0] | adjacent 0.5 m tiles
routes_are_open | uav.0.initial_altitude=14 & ugv.0.building_clearance=1
& building=[{polygon=[[1,8.9],[6.2,8.9],[6.2,9.5]],height=3}] | ugv.0.position = [7.0, 8.0] | building_clearance = 1 m
routes_are_open | uav.0.initial_altitude=14 & ugv.0.building_clearance=1
& building=[{polygon=[[1,1],[5.5,1],[5.5,12]],height=3}] | ugv.0.position = [7.0, 8.0] | building_clearance = 1 m
routes_are_open | uav.0.initial_altitude=14 & ugv.0.building_clearance=1
& building=[{polygon=[[9,0],[9.5,0],[9.5,20],[9,20]],height=3},{polygon=[[9,22],[9.5,22],[9.5,40],[9,40]],height=3}]
| ugv.0.goals.0 = [14.0, 8.0] | building_clearance = 1 m
circle_is_within_sight | law.name=circle & law.parameters.circle_radius=4.75
| law.parameters.circle_radius = 4.75 | less than r_v = 4.75 m
circle_is_within_sight | law.name=circle & uav.0.max_acceleration=inf
| law.parameters.circle_radius | less than r_v = 4.75 m
teams_are_possible | team.guards=2 | team.guards = 2 | up to 1
teams_are_possible | team.scout_range=4 | team.scout_range = 4.0 | from 4.75 m
teams_are_possible | team.scout_range=9.2 | team.scout_range = 9.2 | up to 9.09 m
teams_are_possible | team.guards=1 & uav.0.initial_altitude=14 | uav.0.max_altitude = 120.0 | up to 58
teams_are_possible | team.guards=1 & uav.0.initial_altitude=14 & uav.0.max_altitude=16 | uav.0.min_altitude = 1.0
| from 3.81 m
bands_are_apart | team.guards=1 & uav=[{position=[7,9]},{position=[8,9]}] & uav.*.initial_altitude=14
& uav.1.initial_altitude=15 & uav.*.min_altitude=9 & uav.*.max_altitude=17
| uav.1.initial_altitude = 15.0 | 16 m, with uav.0.max_altitude = 14 and uav.1.min_altitude = 16
endurances_suffice | uav.0.endurance=300 | uav.0.endurance = 300.0 | with [team]
endurances_suffice | team.guards=1 & uav.0.endurance=300 | uav.0.base | [x, y] in m
endurances_suffice | team.guards=1 & uav.0.endurance=300 & uav.0.base=[50,3]
| uav.0.base = [50.0, 3.0] | [0, 40] x [0, 40] m
endurances_suffice | team.guards=1 & uav.0.endurance=150 & uav.0.base=[20,20]
| uav.0.endurance = 150.0 | above 224.6 s
""")
]


@pytest.mark.parametrize(("check", "overrides", "field", "allowed"), BROKEN)
def test_refusal_names_file_field_value_and_allowed_values(
    check, overrides, field, allowed
) -> None:
    line = refusal(overrides=overrides)
    head, _, rest = line.partition("; allowed: ")
    assert head.startswith(f"escort: {field}")
    assert head.removeprefix(f"escort: {field}")[0] in ":,"  # the value is complete
    assert allowed in rest


def test_every_check_has_a_row_above() -> None:
    assert {check for check, *_ in BROKEN} == set(CHECKS)


def every_refusal(overrides: list[str]) -> tuple[str, ...]:
    """Return the line of each independent fault, without the scenario's name."""
    with pytest.raises(ScenarioError) as caught:
        load_scenario("escort", overrides=overrides, every=True)
    assert refusal(overrides=overrides) == caught.value.args[0]
    return tuple(line.removeprefix("escort: ").partition(":")[0] for line in caught.value.args)


def test_all_independent_faults_are_found_at_once() -> None:
    """Their consequences are left out: a UAV outside the area is also too far from its UGV."""
    changes = (
        "uav.0.position=[100,2] visibility.radius=20 uav.0.max_speed=0.1 dt=2.0 detections.rate=3"
    )
    assert every_refusal(changes.split()) == (
        "dt = 2.0",
        "visibility.radius = 20.0",
        "uav.0.position = [100.0, 2.0]",
        "uav.0.max_speed = 0.1",
    )


def test_all_wrong_types_are_found_at_once() -> None:
    changes = (
        "duraton=5 area.cell=a uav.0.fast=3 uav.0.max_speed=-1 ugv.0.goals=[[1]] team.guards=x"
    )
    assert set(every_refusal(changes.split())) == {
        "duraton = 5",
        'area.cell = "a"',
        "uav.0.fast = 3",
        "uav.0.max_speed = -1",
        "ugv.0.goals.0 = [1]",
        'team.guards = "x"',
    }


def test_any_faults_together_are_refused() -> None:
    """A check that relies on another one is left out, and does not fail on what it cannot use."""
    random = Random(1)
    for _ in range(200):
        every_refusal([change for row in random.sample(BROKEN, 3) for change in row[1]])


@pytest.mark.parametrize(
    "path", ["law.parameters.circle_rate", "uav.0.max_speed", "ugv.0.goals.2.0"]
)
@pytest.mark.parametrize("value", ["nan", "-nan", "-inf"])
def test_nan_and_minus_infinity_are_refused_everywhere(path: str, value: str) -> None:
    assert refusal(overrides=[f"{path}={value}"]).startswith(
        f"escort: {path} = {value.lstrip('-') if 'nan' in value else value}: "
    )


def test_infinite_bounds_are_allowed_for_vehicles() -> None:
    bounds = ["uav.0.max_speed=inf", "uav.0.max_acceleration=inf"]
    s = load_scenario("escort", overrides=[*bounds, "law.parameters.reference_speed=0.6"])
    assert s.uav[0].max_speed == s.uav[0].max_acceleration == math.inf
    assert load_scenario("escort", overrides=["law.name=tracking", "uav.0.max_speed=inf"])


def test_a_scenario_may_have_the_parameters_of_several_laws() -> None:
    s = load_scenario("escort", overrides=["law.name=tracking", "law.parameters.horizon=9"])
    assert law_parameters(s.law) == law_parameters(Law(name="tracking"))


CHANGES = [
    *rows(r"""
dt=true | dt = true: a truth value; allowed: a number
dt=-1 | dt = -1: out of bounds; allowed: a number > 0.0
duration=1e400 | duration = inf: out of bounds; allowed: a number <= 1000000000000.0
seed=1.5 | seed = 1.5: not whole; allowed: a whole number
title=2020-01-01 | title = 2020-01-01: a date or time; allowed: text
detections.dropout=2 | detections.dropout = 2: out of bounds; allowed: a number <= 1.0
law={name="lookahead",parameters={horizon=0.1}}
| law.parameters.horizon = 0.1: out of bounds; allowed: a number >= 0.5
law={name="lookahead",parameters={candidates=2.5}}
| law.parameters.candidates = 2.5: not whole; allowed: a whole number
law.parameters.reference_speed=x | law.parameters.reference_speed = "x": text; allowed: a number, or true or false
estimator.enabled=1 | estimator.enabled = 1: a number; allowed: true or false
links.profile=wify | links.profile = "wify": unknown profile, did you mean 'wifi'?
links.everything.delay=1 | links.everything = {delay = 1}: unknown field
links.commands=3 | links.commands = 3: a number; allowed: a table
uav.0.position=[1, 2, 3] | uav.0.position = [1, 2, 3]: out of bounds; allowed: a list of length 2
uav.0.position=[1, true] | uav.0.position.1 = true: a truth value; allowed: a number
uav.0.name=UAV | uav.0.name = "UAV": not a name; allowed: lower-case letters
ugv=[] | ugv = []: out of bounds; allowed: a list of length >= 1
uav.0.escorts=["ugv_0"] | uav.0.escorts = ["ugv_0"]: a list; allowed: the name of one UGV
dt=0.0003 | duration = 200.0: not a whole number of ticks; allowed: multiples of dt = 0.0003 s, such as 200.0001
detections.rate=17 | detections.rate = 17.0: the period is not a whole number of ticks; allowed: 20, 10, 6.666667, ...
area.cell=0.01 | area.cell = 0.01: makes 1.6e+07 cells, more than 4,000,000; allowed: 0.02 m or more
duration=500000.05 | duration = 500000.05: makes 10000001 ticks; allowed: 10,000,000 ticks at most, 500000 s
uav.0.velocity=[0.6000001, 0] | uav.0.velocity = [0.6000001, 0.0]: a speed of 0.6000001 m/s; allowed: up to
ugv.0.max_speed=0.7000001 | uav.0.max_speed = 0.6: not above the UGV ugv_0; allowed: above 0.7000001 m/s
uav={position=[1, 2]} | uav = {position = [1, 2]}: a single table; allowed: a list, in TOML [[uav]]
coverage.covered=[{lower=[1, 1]}] | coverage.covered.0.upper: missing; allowed: [x, y] in m
building=[{height=0,polygon=[]}] | building.0.height = 0: out of bounds; allowed: a number > 0
building_field=[{block=[4,5],street=4}] | building_field.0.height: missing; allowed: [smallest, largest] in m
building_field=[{block=[0.01,5],street=4,height=[3,4]}] | building_field.0.block.0 = 0.01: out of bounds
camera.half_angle=1.6 | camera.half_angle = 1.6: out of bounds; allowed: a number < 1.57079
camera.half_angle=0 | camera.half_angle = 0: out of bounds; allowed: a number > 0
uav.0.initial_altitude=inf | uav.0.initial_altitude = inf: out of bounds; allowed: a number <= 100000
sead=3 | sead = 3: unknown field, did you mean 'seed'?; allowed: name, title, seed, duration, dt
certificate.risk=0.01 | certificate.risk = 0.01: unknown field; allowed: max_measurement_error, max_measurement_age
law.nmae=circle | law.nmae = "circle": unknown field, did you mean 'name'?; allowed: name, parameters
law.speed_gain=2 | law.speed_gain = 2: unknown field, did you mean 'law.parameters.speed_gain'?
coverage.covered=[{lower=[1, 1], uper=[2, 2]}]
| coverage.covered.0.uper = [2, 2]: unknown field, did you mean 'upper'?; allowed: lower, upper
duration | --set = "duration": not of the form key=value; allowed: key=value, such as
law..name=x | --set = "law..name=x": not of the form key=value
uav.1.max_speed=1 | uav.1.max_speed = 1: uav has no entry "1"; allowed: uav.0
uav.count=2 | uav.count = 2: not a number of the entries to keep; allowed: 1 to 1
uav.²=1 | uav.² = 1: uav has no entry "²"; allowed: uav.0
ugv.0.goals.9=[1, 1]
| ugv.0.goals.9 = [1, 1]: ugv.0.goals has no entry "9"; allowed: ugv.0.goals.0 to ugv.0.goals.4
seed.x=1 | seed.x = 1: seed = 7 is not a table; allowed: a value for seed itself
dt=0.3 | duration = 200.0: not a whole number of ticks; allowed: multiples of dt = 0.3 s, such as 200.1
"""),
    [f"seed={'1' * 5000}", 'seed = "111'],
    [f"seed=0x{'f' * 9000}", "seed = 0xfff"],
]


@pytest.mark.parametrize(("change", "start"), CHANGES)
def test_impossible_override_is_a_scenario_error(change: str, start: str) -> None:
    line = refusal(overrides=[change])
    assert line.startswith(f"escort: {start}")
    assert len(line) < 250 or "unknown field" in line


@given(st.floats(1e-3, 1e6), st.integers(1, 10**6), st.integers(3, 6))
def test_rounded_numbers_do_not_contradict_their_bounds(bound, steps, digits):
    more = bound * (1.0 + steps * 2.0**-50)
    assert bound == float(exact(bound)) < float(above(more, bound, digits))
    assert float(below(bound, more, digits)) < more
    assert float(at_most(bound, digits)) <= bound * (1.0 + 1e-11)
    assert float(at_least(bound, digits)) >= bound * (1.0 - 1e-11)


@pytest.mark.parametrize(
    "changes",
    [
        "dt=0.0003 & detections.rate=3333.333333 & duration=200.0001",
        "detections.rate=6.666667",
        "area.cell=0.02",
    ],
)
def test_the_allowed_numbers_of_an_error_are_accepted(changes: str) -> None:
    """Rows of `CHANGES` above name them."""
    load_scenario("escort", overrides=["detections.rate=20", *changes.split(" & ")])


# Files

NO_TOML = "not TOML: Invalid value (at line 2, column 8); allowed: TOML 1.0"


@pytest.mark.parametrize(
    ("content", "rest"),
    [
        (b"dt = 0.05\nseed = = 3\n", NO_TOML),
        (b"dt = 0.05\r\nseed = x\r\n", NO_TOML),
        (b"dt = 0.05\ntitle = '''\n", "not TOML: "),
        (b"seed = " + b"1" * 5000, "not TOML: "),
        (b"seed = " + b"[" * 5000, "not TOML: "),
        (b"a" + b".a" * 60 + b" = 1", "a = {a = {"),
        (b"a" + b".a" * 3000 + b" = 1", "a key of more than 64 parts"),
        (b'"a\\nb" = 3', "a\\nb = 3: unknown field; allowed: name, "),
        (b"title = '\xff'", "byte 9: not UTF-8, invalid start byte; allowed: text in UTF-8"),
        (b"", "ugv: missing; allowed: one table [[ugv]] or more"),
        (b"[[uav]]\n", "uav.0.position: missing; allowed: [x, y] in m"),
    ],
)
def test_a_broken_file_is_refused_with_its_name_and_the_place(content, rest, tmp_path):
    path = written(tmp_path, content)
    assert refusal(path).startswith(f"{path}: {rest}")


def test_an_unreadable_file_is_refused(tmp_path: Path) -> None:
    assert refusal(tmp_path).startswith(f"{tmp_path}: cannot be read: Is a directory")
    assert refusal("a\0b").startswith("a\\x00b: cannot be read")
    assert "cannot be read" in refusal("x" * 5000)


@pytest.mark.parametrize("source", ["escrot", "no-such.toml", "/no/such/folder/escort.toml"])
def test_unknown_scenario_lists_the_known_and_the_closest(source: str) -> None:
    line = refusal(source)
    assert line.startswith(f"{source}: no such file or scenario")
    assert line.endswith(f"a TOML file, or {', '.join(SHIPPED)}")
    assert ("did you mean 'escort'?" in line) == ("esc" in source)


# Invalid files and values

FUZZ = settings(
    max_examples=200,
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)
TEXTS = [
    path.read_bytes() for path in sorted((Path(checks.__file__).parent / "shipped").glob("*.toml"))
]
NUMBERS = [math.nan, math.inf, -math.inf, 1e308, 1e12, 1e13, 5e-324, 1e-300, -0.0, 0, 1, 10**400]
ODD = (
    st.sampled_from([*NUMBERS, -(2**63), "", "inf", None, True])
    | (st.floats() | st.integers() | st.text(max_size=8))
    | st.lists(st.floats() | st.text(max_size=3), max_size=3)
    | st.dictionaries(st.text(max_size=4), st.integers(), max_size=2)
)


def paths(value: object, path: tuple[str, ...] = ()) -> list[str]:
    """Return the path of every table, list and value of the escort."""
    inner = value.items() if isinstance(value, dict) else ()
    inner = enumerate(value) if isinstance(value, tuple) else inner
    return [".".join(path)] * bool(path) + [
        found for key, part in inner for found in paths(part, (*path, str(key)))
    ]


PATHS = paths(msgspec.to_builtins(ESCORT))


def must_load_or_be_refused_in_one_line(source, overrides=()) -> None:
    line = ""
    try:
        scenario = load_scenario(source, overrides=overrides)
    except ScenarioError as error:
        line = str(error)
    assert len(line.splitlines()) <= 1
    assert line.isprintable()
    if line:
        return
    assert check_scenario(scenario) == scenario
    scenario_warnings(scenario)
    for vehicle in scenario.vehicles:  # its briefing fits the bounds of the messages
        briefed = briefing(scenario, vehicle.name, scenario.seed)
        assert msgspec.json.decode(msgspec.json.encode(briefed), type=type(briefed)) == briefed


@FUZZ
@given(
    st.binary(max_size=60) | st.text(max_size=60).map(lambda text: text.encode("utf-8", "replace"))
)
def test_garbage_is_never_anything_but_a_scenario_error(tmp_path: Path, garbage: bytes) -> None:
    must_load_or_be_refused_in_one_line(written(tmp_path, garbage))
    must_load_or_be_refused_in_one_line(written(tmp_path, SMALL.encode() + garbage))


@FUZZ
@given(
    st.sampled_from(TEXTS),
    st.integers(0, 2000),
    st.integers(0, 12),
    st.binary(max_size=12) | st.sampled_from([b"nan", b"1e999", b"[["]),
)
def test_a_mutated_file_is_never_anything_but_a_scenario_error(tmp_path, text, at, cut, put):
    at = min(at, len(text))
    must_load_or_be_refused_in_one_line(written(tmp_path, text[:at] + put + text[at + cut :]))


@FUZZ
@given(st.dictionaries(st.sampled_from(PATHS), ODD, min_size=1, max_size=3))
def test_a_mutated_value_is_never_anything_but_a_scenario_error(changes: dict[str, object]) -> None:
    must_load_or_be_refused_in_one_line("escort", changes)


@FUZZ
@given(
    st.lists(
        st.text(max_size=30)
        | st.tuples(st.sampled_from(PATHS), ODD).map(lambda pair: f"{pair[0]}={pair[1]}"),
        max_size=3,
    )
)
def test_mutated_overrides_raise_only_scenario_errors(changes: list[str]) -> None:
    must_load_or_be_refused_in_one_line("escort", changes)
