"""Controllers: from an observation to sprocket torques, one idea a file."""
