"""Fly a quadrotor with attitude and motors."""
