"""Models shared by the world and the vehicles."""
