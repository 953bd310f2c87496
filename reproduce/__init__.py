"""The experiments of the two papers, run again with the project's own models."""
