"""Plants: one file for each, with all that the engine needs of it."""
