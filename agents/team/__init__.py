"""Cooperation of the UAVs that escort the same UGV: roles, numbers and shared coverage (docs/explanation/teams.md)."""
