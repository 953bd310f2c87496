"""Planners of motion for tracked vehicles: from a pose to a goal, with or without slip."""
