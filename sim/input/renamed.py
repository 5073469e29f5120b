"""Former names of a scenario's fields, so that an error names the new field."""

RENAMED = {
    "hold": "command_timeout",
    "certificate.error": "certificate.max_measurement_error",
    "certificate.age": "certificate.max_measurement_age",
    "certificate.delay": "certificate.max_command_delay",
    "certificate.outage": "certificate.max_command_interval",
    "certificate.tracking": "certificate.max_tracking_error",
    "detections.cut": "detections.truncation",
    "estimator.patience": "estimator.max_rejections",
    "estimator.manoeuvre": "estimator.acceleration_share",
    "ground.telling": "ground.map_update_rate",
    "ground.bumper": "ground.sensing_range",
    "hazard.share": "hazard.speed_share",
    "hazard_field.share": "hazard_field.speed_share",
    "hazard_field.clear": "hazard_field.clearance",
    "uav.own_error": "uav.position_error",
    "uav.own_error_time": "uav.position_error_time",
    "ugv.track": "ugv.trajectory",
}
"""Present names of fields, by former name. Indices of lists are omitted."""
_LINK_FIELDS = {"jitter_cut": "max_jitter"}


def new_name(path: list[str], field: str) -> str:
    """Return the present name of a field, or an empty string if it was not renamed.

    Args:
        path: Tables and indices on the path to the field.
        field: Name in the scenario.
    """
    if path[:1] == ["links"] and field in _LINK_FIELDS:
        return _LINK_FIELDS[field]
    tables = [part for part in path if not part.isdigit()]
    return RENAMED.get(".".join([*tables, field]), "").rpartition(".")[2]
