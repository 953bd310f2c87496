"""Slip of tracks identified beforehand or on line, and the models that hold it."""
