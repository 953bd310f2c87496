"""Model predictive controllers: they drive along the reference that the observation shows ahead."""
