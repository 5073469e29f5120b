"""Quadrotor as a body, the entry point `outrider.bodies`."""

from bus.rows import BodyRow

QUADROTOR = BodyRow(
    name="quadrotor",
    about="rigid-body quadrotor with attitude and motor dynamics (MuJoCo)",
    make="outrider_quadrotor.quadrotor:Quadrotor",
)
"""Rigid body of a Holybro X500 V2, for `uav.body`."""
