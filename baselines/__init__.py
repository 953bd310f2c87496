"""Model-based policies: controllers and estimators that know only a nominal model."""
